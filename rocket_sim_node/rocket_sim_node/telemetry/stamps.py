# SPDX-License-Identifier: Apache-2.0
"""Time stamps of a simulator's steps."""
from __future__ import annotations

NANOSECONDS = 1_000_000_000
LATEST = 2**31 * NANOSECONDS
"""ns, end of what a message can say: its seconds have 32 bits."""


class Stamps:
    """Stamps of steps, in ns of simulated time, which never go backwards.

    In the first session the stamp of step k is `k * dt`. A later session starts again with its own
    steps; its first one comes one `dt` after the last stamp that was given.
    """

    def __init__(self) -> None:
        """Begin before the first step."""
        self._session: tuple[int, float] | None = None
        self._first = 0
        self._origin = 0
        self.last = -1
        """The newest stamp so far, ns; -1 before the first one."""

    def of(self, session: int, step: int, dt: float) -> int:
        """Return the stamp of a step, ns; that of an older step than the newest is its stamp.

        :param dt: s per step.
        :raises ValueError: when no message could say it; then nothing has changed.
        """
        self.check(session, step, step, dt)
        if (session, dt) != self._session:
            self._first, self._origin = self._start(step, dt)
            self._session = session, dt
        stamp = max(self._origin + _nanoseconds(step - self._first, dt), self.last)
        self.last = stamp
        return stamp

    def check(self, session: int, first: int, last: int, dt: float) -> None:
        """Check that the steps from `first` to `last` can have stamps.

        :raises ValueError: when no message could say the last one.
        """
        begin, origin = self._first, self._origin
        if (session, dt) != self._session:
            begin, origin = self._start(first, dt)
        if first < 0 or origin + _nanoseconds(last - begin + 1, dt) >= LATEST:
            raise ValueError(f'step: {first} to {last}, later than a stamp can say')

    def _start(self, step: int, dt: float) -> tuple[int, int]:
        """Return first step and its stamp for a session that begins."""
        return (0, 0) if self._session is None else (step, self.last + _nanoseconds(1, dt))

    def next(self) -> int:
        """Return a stamp 1 ns after the newest: for a second state at the same time.

        A rocket that finishes is at the end of one episode and at the start of the next one in the
        same step, and tf2 keeps one transform for each stamp.
        """
        self.last += 1
        return self.last


def _nanoseconds(steps: int, dt: float) -> int:
    # Step by step, so that the sum does not depend on where a session began: dt itself is
    # rounded to ns once.
    return steps * round(dt * NANOSECONDS)
