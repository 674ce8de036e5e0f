# SPDX-License-Identifier: Apache-2.0
"""Programs that write the figures of benchmarks into pages of docs/results."""
