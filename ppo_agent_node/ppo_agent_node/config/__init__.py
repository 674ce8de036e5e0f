# SPDX-License-Identifier: Apache-2.0
"""The settings of a training run, and presets of them."""
