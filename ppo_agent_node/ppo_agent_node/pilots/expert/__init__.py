# SPDX-License-Identifier: Apache-2.0
"""The scripted pilots of the rocket worlds."""
