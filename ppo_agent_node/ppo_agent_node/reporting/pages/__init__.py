# SPDX-License-Identifier: Apache-2.0
"""The HTML pages of runs and evaluations."""
