# SPDX-License-Identifier: Apache-2.0
"""Notices when the system clock is set, and ends the waits that this would prolong.

The middleware waits until a time of the system clock. If that clock is set back by an hour during
a wait, the wait takes an hour longer, unless a message ends it
(https://github.com/ros2/ros2/issues/1080).
"""
from __future__ import annotations

import threading
import time
import weakref
from typing import Protocol

_PERIOD = 0.2
"""Seconds between two looks at the clock."""
_STEP = 0.1
"""A change of this much between two looks is a step, s; clocks are adjusted more slowly."""


class Waiting(Protocol):
    """An object whose wait can be ended from another thread."""

    def wake(self) -> None:
        """End the current wait, or else the next one, early."""
        ...


class Watch:
    """A thread that wakes waiting objects after a step of the system clock.

    It runs as long as there are any.
    """

    def __init__(self) -> None:
        """Start with no objects."""
        self._waiting: weakref.WeakSet[Waiting] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def add(self, waiting: Waiting) -> None:
        """Wake an object after each step from now on, for as long as it exists."""
        with self._lock:
            self._waiting.add(waiting)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name='clock', daemon=True)
                self._thread.start()

    def discard(self, waiting: Waiting) -> None:
        """Wake an object no longer; it is not being woken when this returns."""
        with self._lock:
            self._waiting.discard(waiting)

    def _run(self) -> None:
        before = _difference()
        while True:
            time.sleep(_PERIOD)  # by the steady clock
            now = _difference()
            with self._lock:
                if not self._waiting:
                    self._thread = None
                    return
                if abs(now - before) > _STEP:
                    for one in self._waiting:
                        one.wake()
            before = now


def _difference() -> float:
    """Return the system clock less the steady clock, s."""
    return time.time() - time.monotonic()


WATCH = Watch()
"""The watch of this process."""
