# SPDX-License-Identifier: Apache-2.0
"""Appearance of each world in the viewer."""
