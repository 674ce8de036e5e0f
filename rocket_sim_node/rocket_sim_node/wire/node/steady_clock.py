# SPDX-License-Identifier: Apache-2.0
"""Timers on the steady clock, unaffected by changes of the system time.

A node's default timers follow ROS time, which is the system time unless a simulation overrides it:
if the system clock is set back by an hour, they do not fire for an hour.
"""
from __future__ import annotations

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
