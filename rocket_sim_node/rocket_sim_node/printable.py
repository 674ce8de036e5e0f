# SPDX-License-Identifier: Apache-2.0
"""Sanitizing of external text for terminals and logs."""
from __future__ import annotations

import os
import shlex
from collections.abc import Iterable


def printable(text: str, spared: str = '') -> str:
    """Return a text with each non-printable character replaced by a space.

    :param spared: characters to keep regardless.
    """
    return ''.join(sign if sign.isprintable() or sign in spared else ' ' for sign in text)


def shell_command(words: Iterable[object]) -> str:
    """Return a command, quoted for bash or zsh; it holds printable characters only."""
    return ' '.join(_shell_word(str(word)) for word in words)


def printable_path(path: object) -> str:
    """Return a path as it is, or quoted for a shell where it has non-printable characters."""
    text = str(path)
    return text if text.isprintable() else _shell_word(text)


def _shell_word(text: str) -> str:
    if text.isprintable():
        return shlex.quote(text)
    # Bytes in octal, of three digits each: a digit that follows is not taken for one of them.
    return "$'" + ''.join(
        sign if sign.isprintable() and sign not in "\\'"
        else ''.join(f'\\{byte:03o}' for byte in os.fsencode(sign)) for sign in text) + "'"
