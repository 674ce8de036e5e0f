# SPDX-License-Identifier: Apache-2.0
"""Timers that go on whatever is done to the clock of the machine.

A timer of a node goes by ROS time, which is the machine's unless a simulation gives another: set
back by an hour, it would fire no more for an hour.
"""
from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""a clock that only goes forwards"""


def create_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a timer of a node that fires every `period` s of a clock that only goes forwards."""
    return node.create_timer(period, callback, clock=STEADY)
