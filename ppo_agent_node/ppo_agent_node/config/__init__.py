# SPDX-License-Identifier: Apache-2.0
"""Settings of a training run, and presets of them."""
