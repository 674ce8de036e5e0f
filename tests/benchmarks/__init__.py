# SPDX-License-Identifier: Apache-2.0
"""Comparisons with peers, side by side in one run; `./launch_scripts/bench` runs them."""
