# SPDX-License-Identifier: Apache-2.0
"""Validation of input from open topics: invalid messages are skipped with a warning."""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import OWN_FIELDS
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.node.steady_clock import STEADY

_BEYOND_ALL = 1e30
"""Limit that no valid quantity reaches; recordings hold single precision."""


@contextmanager
def leaving_out(node: Node, what: str) -> Iterator[None]:
    """Run code that handles received messages; skip invalid input with a warning.

    Values of a world description are used in computations far from where it was received, so the
    error may occur there. Failures of files or viewers are not caught (`OSError`, `ViewerError`).
    """
    try:
        yield
    except (ValueError, TypeError, ArithmeticError, LookupError, MemoryError) as error:
        node.get_logger().warning(
            f'{what} left out: {error or type(error).__name__}', throttle_duration_sec=1.0,
            throttle_time_source_type=STEADY)


def samples_from_message(message: msg.RocketState) -> Samples:
    """Return the samples in a message.

    :raises ValueError: when a field has the wrong length or a non-finite value, naming it.
    """
    samples = Samples.build(
        conversion.from_sequence(message.step, 'u8'), conversion.from_sequence(message.row, 'u4'),
        conversion.from_sequence(message.episode, 'u8'),
        conversion.from_sequence(message.outcome, 'u1'),
        contact=conversion.from_sequence(message.contact, 'u1'),
        **{name: conversion.from_sequence(getattr(message, name), 'f8')
           for name in (*FIELDS, 'leg_angle', 'terrain', 'conditions')})
    good = np.abs(samples.values) < _BEYOND_ALL
    if not good.all():
        name = next(name for name in (*FIELDS, *OWN_FIELDS)
                    if not good[:, samples.layout.place(name)].all())
        raise ValueError(f'{name}: a value is not finite, or beyond {_BEYOND_ALL:g}')
    return samples
