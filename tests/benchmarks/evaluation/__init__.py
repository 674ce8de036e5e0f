# SPDX-License-Identifier: Apache-2.0
"""Pilots and policies: returns here and in Gymnasium, distance from the optimum, tuning."""
