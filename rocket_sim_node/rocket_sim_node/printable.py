# SPDX-License-Identifier: Apache-2.0
"""Texts that others wrote, made fit for a terminal or a log."""
from __future__ import annotations


def printable(text: str, spared: str = '') -> str:
    """Return a text that moves no cursor: a space for each sign that is not printable.

    :param spared: signs that stay all the same.
    """
    return ''.join(sign if sign.isprintable() or sign in spared else ' ' for sign in text)
