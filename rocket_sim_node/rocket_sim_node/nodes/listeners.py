# SPDX-License-Identifier: Apache-2.0
"""Functions and constants shared by the nodes that only listen."""
from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.recording.sinks.destinations import Note

SPIN_PERIOD = 0.2
"""Seconds per spin; the events executor needs a finite time-out, for signals."""
NICENESS = 10
"""Niceness relative to simulator and agent, when there are not enough cores."""
_QUIET = 0.2
_DRAIN = 1.5
"""When asked to stop, a recorder waits until no message came for the first time, s, and at most
for the second."""


def notes_of(node: Node) -> Note:
    """Return a function that logs a text of a level with a node's logger."""
    def note(level: str, text: str) -> None:
        logger = node.get_logger()
        # Separate calls: a logger rejects different severities from the same line.
        if level == 'ERROR':
            logger.error(text)
        elif level == 'WARN':
            logger.warning(text)
        else:
            logger.info(text)
    return note


def drain(executor: Executor, count: Callable[[], int]) -> None:
    """Receive messages still in transit, as simulator and agent may be stopping as well.

    :param count: returns the number of messages received so far.
    """
    end = time.monotonic() + _DRAIN
    before, quiet_at = count(), time.monotonic() + _QUIET
    while time.monotonic() < min(end, quiet_at):
        executor.spin_once(timeout_sec=0.01)
        if count() != before:
            before, quiet_at = count(), time.monotonic() + _QUIET
