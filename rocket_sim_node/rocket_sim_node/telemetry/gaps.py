# SPDX-License-Identifier: Apache-2.0
"""Count of the steps that a listener has missed."""
from __future__ import annotations

from typing import TypeVar

T = TypeVar('T')
_SESSIONS = 8
"""Sessions that are remembered: two simulators by mistake on one topic take turns."""


def of_session(memory: dict[int, T], session: int, new: T) -> T:
    """Return what is remembered of a session, at first `new`; forget the oldest of many others."""
    found = memory.pop(session, new)
    if len(memory) == _SESSIONS:
        del memory[next(iter(memory))]
    memory[session] = found
    return found


class GapCounter:
    """Counts missed steps: within a session they are numbered one after the other, from 0.

    A step may be published again; that is no gap. Nothing is known of steps before the first
    message of all, nor of the last steps of a session.
    """

    def __init__(self, whole_sessions: bool = True) -> None:
        """Start before the first message.

        :param whole_sessions: whether the first steps of later sessions count; not for a topic
            on which anybody may name any session.
        """
        self._whole = whole_sessions
        self._last: dict[int, int] = {}
        self.missed = 0
        """Steps missed so far."""

    def note(self, session: int, first: int, last: int | None = None) -> int:
        """Note a message with the steps from `first` to `last`; return how many were missed.

        :param last: None for a message of one step.
        """
        last = first if last is None else last
        before = of_session(
            self._last, session, -1 if self._last and self._whole else first - 1)
        missing = max(first - before - 1, 0)
        self._last[session] = max(before, last)
        self.missed += missing
        return missing
