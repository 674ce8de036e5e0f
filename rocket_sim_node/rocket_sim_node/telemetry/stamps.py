# SPDX-License-Identifier: Apache-2.0
"""Time stamps of a simulator's steps, in simulated time."""
from __future__ import annotations

NANOSECONDS = 1_000_000_000
LATEST = 2**31 * NANOSECONDS
"""ns, end of what a message can say: its seconds have 32 bits."""
LATEST_TOLD = LATEST // 2
"""ns, 34 years: the latest simulated time of a simulator. A reader that followed it, or a wrong
stamp, can still give later stamps to later sessions."""


class Stamps:
    """Stamps of steps, in ns of simulated time, which never go backwards.

    A simulator stamps its messages. What it sends is followed, unless it would go backwards: after
    a restart or a reset of its time, a session begins one `dt` after the last stamp given here.
    Without stamps, step k of the first session is at `k * dt`, and so is each later session.
    """

    def __init__(self) -> None:
        """Start before the first step."""
        self._session: tuple[int, float] | None = None
        self._first = 0
        self._origin = 0
        self.last = -1
        """The newest stamp so far, ns; -1 before the first one."""

    def of(self, session: int, step: int, dt: float, own_stamp: int | None = None) -> int:
        """Return the stamp of a step, ns; that of an older step than the newest is its stamp.

        :param dt: s per step.
        :param own_stamp: ns, the simulator's own stamp of this step; None: it is not known.
        :raises ValueError: when no message could say it; then nothing has changed.
        """
        self.check(session, step, step, dt, own_stamp)
        if (session, dt) != self._session:
            self._first, self._origin = self._start(step, dt, own_stamp)
            self._session = session, dt
        stamp = max(self._origin + nanoseconds(step - self._first, dt), self.last)
        self.last = stamp
        return stamp

    def check(
        self, session: int, first: int, last: int, dt: float, own_stamp: int | None = None,
    ) -> None:
        """Check that the steps from `first` to `last` can have stamps.

        :param own_stamp: ns, the simulator's own stamp of `first`.
        :raises ValueError: when no message could say the last one.
        """
        begin, origin = self._first, self._origin
        if (session, dt) != self._session:
            begin, origin = self._start(first, dt, own_stamp)
        if first < 0 or origin + nanoseconds(last - begin + 1, dt) >= LATEST:
            raise ValueError(f'step: {first} to {last}, later than a stamp can say')

    def _start(self, step: int, dt: float, own_stamp: int | None) -> tuple[int, int]:
        """Return first step and its stamp for a session that begins."""
        if own_stamp is not None and own_stamp > self.last:
            return step, own_stamp
        return (0, 0) if self._session is None else (step, self.last + nanoseconds(1, dt))

    def next(self) -> int:
        """Return a stamp 1 ns after the newest: for a second state at the same time.

        A rocket that finishes is at the end of one episode and at the start of the next one in the
        same step, and tf2 keeps one transform for each stamp.
        """
        self.last += 1
        return self.last


class SimulatedTime:
    """Simulated time of one simulator, ns, over all its sessions: it never goes backwards.

    It begins with 0 at step 0 of the first session. A later session begins one `dt` after the last
    step of the one before.
    """

    def __init__(self, dt: float) -> None:
        """Start before the first session.

        :param dt: s per step.
        """
        self._dt = dt
        self._origin = -nanoseconds(1, dt)

    def begin_session(self, steps: int) -> None:
        """Start a session.

        :param steps: taken in the session before.
        """
        self._origin += nanoseconds(steps + 1, self._dt)

    def restart(self) -> None:
        """Let the present session begin at 0."""
        self._origin = 0

    def at(self, step: int) -> int:
        """Return the time of a step of the present session, up to `LATEST_TOLD`."""
        return min(self._origin + nanoseconds(step, self._dt), LATEST_TOLD)


def nanoseconds(steps: int, dt: float) -> int:
    """Return the duration of steps of `dt` s, ns."""
    # Step by step, so that the sum does not depend on where a session began: dt itself is
    # rounded to ns once.
    return steps * round(dt * NANOSECONDS)
