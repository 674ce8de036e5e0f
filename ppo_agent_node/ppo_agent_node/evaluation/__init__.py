# SPDX-License-Identifier: Apache-2.0
"""Evaluation: flights that count fairly, figures with their certainty, bounds and pictures."""
