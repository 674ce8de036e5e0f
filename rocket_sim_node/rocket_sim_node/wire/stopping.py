# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as a wish: what is under way comes to a good end, ROS still being there.

The handlers of rclpy would shut ROS down at once and interrupt Python anywhere, in the midst of a
step or of a write; then nobody could be told, and control not be handed back.
"""
from __future__ import annotations

import signal
import threading

_stop = threading.Event()


def listen() -> None:
    """Take SIGINT and SIGTERM as wishes from now on; further ones change nothing."""
    _stop.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: _stop.set())


def requested() -> bool:
    """Return whether this process has been asked to end."""
    return _stop.is_set()
