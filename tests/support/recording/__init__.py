# SPDX-License-Identifier: Apache-2.0
"""Recordings and bags for tests, read back as numbers or as pictures."""
