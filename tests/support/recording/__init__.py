# SPDX-License-Identifier: Apache-2.0
"""Recordings and bags for tests, and functions that read them as numbers or as pictures."""
