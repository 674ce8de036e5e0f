# SPDX-License-Identifier: Apache-2.0
"""Timers and times on the steady clock, unaffected by changes of the system time.

A node's default timers follow ROS time, which is the system time unless a simulation overrides it:
if the system clock is set back by an hour, they do not fire for an hour.
"""
from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""A monotonic clock."""


def create_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a node's timer that fires every `period` s of the steady clock."""
    return node.create_timer(period, callback, clock=STEADY)


class SteadyDate:
    """Times of the day, ns since the epoch, which keep their order if the system time is set."""

    def __init__(self) -> None:
        """Take the system time as it is now."""
        self._start = time.time_ns() - self._steady()

    @staticmethod
    def _steady() -> int:
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)  # runs on while the machine is suspended

    def now(self) -> int:
        """Return the time."""
        return self._start + self._steady()
