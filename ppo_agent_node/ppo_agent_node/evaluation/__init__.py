# SPDX-License-Identifier: Apache-2.0
"""Evaluation of pilots: unbiased episode counts, confidence intervals, bounds and files."""
