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
from collections.abc import Callable
from contextlib import suppress
from typing import Any
from typing import TypeVar

from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.logging import get_logger

T = TypeVar('T')
_PERIOD = 0.2
"""Seconds between two looks at the clock."""
_STEP = 0.1
"""A change of this much between two looks is a step, s; clocks are adjusted more slowly."""


class Watch:
    """A thread that wakes waiting objects after a step of the system clock.

    It runs as long as there are any.
    """

    def __init__(self) -> None:
        """Start with no objects."""
        self._wake: weakref.WeakKeyDictionary[Any, Callable[[Any], None]] = (
            weakref.WeakKeyDictionary())
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def add(self, waiting: T, wake: Callable[[T], None]) -> None:
        """Wake an object after each step from now on, for as long as it exists.

        :param wake: ends its current wait, or else the next one, early; called in a thread.
        """
        with self._lock:
            self._wake[waiting] = wake
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name='clock', daemon=True)
                self._thread.start()

    def _run(self) -> None:
        before = _difference()
        while True:
            time.sleep(_PERIOD)  # by the steady clock
            now = _difference()
            with self._lock:
                if not self._wake:
                    self._thread = None
                    return
                if abs(now - before) > _STEP:
                    self._wake_all()
            before = now

    def _wake_all(self) -> None:
        for one, wake in self._wake.items():
            try:
                wake(one)
            except RuntimeError as error:  # the others are woken all the same
                get_logger('clock').error(f'the system clock was set: {error!r}')


def _difference() -> float:
    """Return the system clock less the steady clock, s."""
    while True:
        before, now, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < _STEP / 10:  # else this thread was held up in between
            return now - before


def wake_executor(executor: Executor) -> None:
    """End the current waits of an executor for events, and for the timers of its nodes."""
    executor.wake()
    for node in executor.get_nodes():
        for timer in node.timers:
            with suppress(InvalidHandle):  # destroyed meanwhile
                if not timer.is_canceled():
                    timer.reset()  # the EventsExecutor then waits anew, for the timer's period


WATCH = Watch()
"""The watch of this process."""
