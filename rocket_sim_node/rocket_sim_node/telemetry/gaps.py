# SPDX-License-Identifier: Apache-2.0
"""Count of the steps that a listener has missed."""
from __future__ import annotations


class GapCounter:
    """Counts missed steps: within a session they are numbered one after the other.

    A step may be published again; that is no gap. Nothing is known of steps before the first
    message, nor of the last steps of a session.
    """

    def __init__(self) -> None:
        """Begin before the first message."""
        self._session, self._last = 0, -1
        self.missed = 0
        """Steps missed so far."""

    def note(self, session: int, first: int, last: int | None = None) -> int:
        """Note a message with the steps from `first` to `last`; return how many were missed.

        :param last: None for a message of one step.
        """
        last = first if last is None else last
        if session != self._session:
            self._session, self._last = session, last
            return 0
        missing = max(first - self._last - 1, 0)
        self._last = max(self._last, last)
        self.missed += missing
        return missing
