# SPDX-License-Identifier: Apache-2.0
"""What writes the figures of benchmarks into pages of docs/results."""
