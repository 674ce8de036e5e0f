# SPDX-License-Identifier: Apache-2.0
"""Benchmarks, with comparisons with peers in the same run; see `./launch_scripts/bench`."""
