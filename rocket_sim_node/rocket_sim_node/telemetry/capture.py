# SPDX-License-Identifier: Apache-2.0
"""Telemetry of a world in this process as z-up samples, without a simulator node."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import OWN_FIELDS
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds.base import Telemetry


def joined(parts: Sequence[tuple[int, Telemetry]]) -> Samples:
    """Return telemetry of several steps as samples, in the same order.

    :param parts: steps and the states at each; at least one.
    """
    def join(name: str) -> NDArray[Any]:
        values = np.concatenate([getattr(part, name) for _, part in parts])
        if name == 'orientation':
            return frames.quaternion_to_ros(values)
        return frames.vector_to_ros(values) if name in frames.VECTORS else values

    return Samples.build(
        np.concatenate([np.full(len(part.row), step) for step, part in parts]),
        join('row'), join('episode'), join('outcome'),
        **{name: join(name) for name in (*FIELDS, *OWN_FIELDS)})
