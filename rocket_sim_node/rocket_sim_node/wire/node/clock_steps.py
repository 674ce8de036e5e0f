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
from contextlib import suppress
from typing import Protocol

from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.logging import get_logger
from rclpy.node import Node

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
                    self._wake_all()
            before = now

    def _wake_all(self) -> None:
        for one in self._waiting:
            try:
                one.wake()
            except RuntimeError as error:  # the others are woken all the same
                get_logger('clock').error(f'the system clock was set: {error!r}')


def _difference() -> float:
    """Return the system clock less the steady clock, s."""
    while True:
        before, now, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < _STEP / 10:  # else this thread was held up in between
            return now - before


class Spinning:
    """A node and its executor, whose waits a step of the system clock would prolong."""

    def __init__(self, node: Node, executor: Executor) -> None:
        """Take an executor that serves the node."""
        self._node, self._executor = node, executor

    def wake(self) -> None:
        """End the current waits of the executor for events, and for timers."""
        self._executor.wake()
        for timer in self._node.timers:
            with suppress(InvalidHandle):  # destroyed meanwhile
                if not timer.is_canceled():
                    timer.reset()  # the EventsExecutor then waits anew, for the timer's period


WATCH = Watch()
"""The watch of this process."""
