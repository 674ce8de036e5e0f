# SPDX-License-Identifier: Apache-2.0
"""How a landing of world `rocket` goes on after its last sample: the planar contact model."""
from __future__ import annotations

import numpy as np

from rocket_sim_node import frames
from rocket_sim_node.recording.flight import Flight
from rocket_sim_node.recording.flight import Settling
from rocket_sim_node.recording.stage import Stage
from rocket_sim_node.worlds.outcome import LANDED
from rocket_sim_node.worlds.outcome import OFF_PAD
from rocket_sim_node.worlds.outcome import OUTCOMES
from rocket_sim_node.worlds.outcome import TIPPED
from rocket_sim_node.worlds.settling import settle

_SETTLE = tuple(OUTCOMES[code] for code in (LANDED, TIPPED, OFF_PAD))
"""Outcomes that are followed; of a touchdown that is too fast the legs would not hold."""


def follow(flight: Flight, stage: Stage) -> Settling | None:
    """Return what becomes of a rocket after its flight; None where that is not asked.

    :param stage: of any world; only flights of `rocket` are followed, others end at rest.
    """
    if stage.world != 'rocket' or flight.outcome not in _SETTLE:
        return None
    settled = settle(
        frames.vector_from_ros(flight.position[-1:]),
        frames.quaternion_from_ros(flight.orientation[-1:]),
        frames.vector_from_ros(flight.linear_velocity[-1:]),
        frames.vector_from_ros(flight.angular_velocity[-1:]),
        flight.fuel[-1:], stage.settings, trajectory=True)
    course = settled.trajectory
    assert course is not None
    # The first moment is that of touchdown, which the flight has.
    count = len(course.position) - 1
    return Settling.build(
        settled.names()[0], frames.vector_to_ros(course.position[1:, 0]),
        frames.quaternion_to_ros(course.orientation[1:, 0]),
        linear_velocity=frames.vector_to_ros(course.linear_velocity[1:, 0]),
        angular_velocity=frames.vector_to_ros(course.angular_velocity[1:, 0]),
        fuel=np.full(count, flight.fuel[-1]), mass=np.full(count, flight.mass[-1]))
