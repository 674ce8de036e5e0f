# SPDX-License-Identifier: Apache-2.0
"""HTML pages of runs and evaluations."""
