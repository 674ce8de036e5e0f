# SPDX-License-Identifier: Apache-2.0
"""The one kind of error that ends a command with a message instead of a traceback."""
from __future__ import annotations

from collections.abc import Iterable

FULL = 'a full ROS 2 supports more'


class CommandError(Exception):
    """An error, as text for the person at the terminal."""


def unknown(found: str, known: Iterable[str]) -> str:
    """Return the refusal of what the real command may know and this one does not."""
    return f'{found} is not supported here, only {", ".join(known)}; {FULL}'
