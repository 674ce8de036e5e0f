# SPDX-License-Identifier: Apache-2.0
"""Sanitizing of external text for terminals and logs."""
from __future__ import annotations


def printable(text: str, spared: str = '') -> str:
    """Return a text with each non-printable character replaced by a space.

    :param spared: characters to keep regardless.
    """
    return ''.join(sign if sign.isprintable() or sign in spared else ' ' for sign in text)
