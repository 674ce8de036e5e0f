# SPDX-License-Identifier: Apache-2.0
"""Scripted pilots of the rocket worlds."""
