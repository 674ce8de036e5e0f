# SPDX-License-Identifier: Apache-2.0
"""Handling of invalid messages on topics to which anyone may publish: skipped, with a warning."""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.node import Node

from rocket_sim_node.wire.node.steady_clock import STEADY


@contextmanager
def ignore_invalid_input(node: Node, what: str) -> Iterator[None]:
    """Run code that handles received messages; skip invalid input with a warning.

    Values of a world description are used in computations far from where it was received, so the
    error may occur there. Failures of files or viewers are not caught (`OSError`, `ViewerError`).
    """
    try:
        yield
    except (ValueError, TypeError, ArithmeticError, LookupError, MemoryError) as error:
        node.get_logger().warning(
            f'{what} ignored: {error or type(error).__name__}', throttle_duration_sec=1.0,
            throttle_time_source_type=STEADY)
