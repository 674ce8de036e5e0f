# SPDX-License-Identifier: Apache-2.0
"""Programs that write the figures of benchmarks to pages in docs/results."""
