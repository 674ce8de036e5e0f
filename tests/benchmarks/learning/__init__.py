# SPDX-License-Identifier: Apache-2.0
"""Whole trainings with several seeds: of presets, and of the examples of the documents."""
