# SPDX-License-Identifier: Apache-2.0
"""Motion after a landing in world `rocket`, simulated by the planar contact model."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rocket_sim_node import frames
from rocket_sim_node.recording.trajectories.trajectory import Settling
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import WIDTH
from rocket_sim_node.worlds.planar.settling import settle
from rocket_sim_node.worlds.rocket.outcome import LANDED
from rocket_sim_node.worlds.rocket.outcome import OFF_PAD
from rocket_sim_node.worlds.rocket.outcome import OUTCOMES
from rocket_sim_node.worlds.rocket.outcome import TIPPED

_SETTLE = tuple(OUTCOMES[code] for code in (LANDED, TIPPED, OFF_PAD))
"""Outcomes that are continued; in a touchdown that is too fast the legs would not hold."""
_FASTEST, _FASTEST_SPIN, _FARTHEST = 100.0, 20.0, 1e5
"""Limits in m/s, rad/s and m from the pad beyond any touchdown."""
_LIGHTEST, _HEAVIEST, _STRONGEST = 0.1, 1e9, 10.0
"""Limits in kg, kg and a factor: beyond any conditions' mass and gravity."""
_GRAVITY = 'gravity_factor'


def follow(flights: Sequence[Trajectory], info: WorldInfo) -> list[Settling | None]:
    """Return the motion of rockets after their flights; None where it is not simulated.

    They are simulated together, which takes little longer than the slowest of them alone.

    :param info: of any world; only flights of `rocket` are continued.
    """
    ends: list[Settling | None] = [None] * len(flights)
    chosen = [
        index for index, flight in enumerate(flights)
        if info.world == 'rocket' and flight.outcome in _SETTLE and _may_be(flight)
        and 0.0 <= _gravity_factor(flight, info) <= _STRONGEST]
    if not chosen:
        return ends
    last = Trajectory(0, 0, 0, '', np.stack([
        flights[index].values[-1, :WIDTH] for index in chosen]))
    settled = settle(
        frames.vector_from_ros(last.position), frames.quaternion_from_ros(last.orientation),
        frames.vector_from_ros(last.linear_velocity),
        frames.vector_from_ros(last.angular_velocity), last.mass, info.settings, motion=True,
        gravity=info.settings['gravity'] * np.array([
            _gravity_factor(flights[index], info) for index in chosen]))
    course, names = settled.motion, settled.names()
    assert course is not None
    for lane, index in enumerate(chosen):
        # The first time is that of touchdown, which the flight already has.
        own = slice(1, int(course.length[lane])), lane
        count = int(course.length[lane]) - 1
        ends[index] = Settling.build(
            names[lane], frames.vector_to_ros(course.position[own]),
            frames.quaternion_to_ros(course.orientation[own]), flights[index].layout,
            linear_velocity=frames.vector_to_ros(course.linear_velocity[own]),
            angular_velocity=frames.vector_to_ros(course.angular_velocity[own]),
            fuel=np.full(count, last.fuel[lane]), mass=np.full(count, last.mass[lane]))
    return ends


def _gravity_factor(flight: Trajectory, info: WorldInfo) -> float:
    """Return the factor of gravity that was drawn for a flight."""
    names = info.condition_names
    known = _GRAVITY in names and flight.layout.conditions == len(names)
    return float(flight.conditions[-1, names.index(_GRAVITY)]) if known else 1.0


def _may_be(flight: Trajectory) -> bool:
    """Return whether the contact model can handle the final state, which comes from a message."""
    def last(name: str) -> float:
        return float(np.linalg.norm(flight.values[-1, FIELDS[name]]))

    return bool(
        not flight.layout.legs and not flight.layout.heights
        and _LIGHTEST <= flight.mass[-1] <= _HEAVIEST and flight.fuel[-1] >= 0.0
        and last('linear_velocity') < _FASTEST and last('angular_velocity') < _FASTEST_SPIN
        and abs(last('orientation') - 1.0) < 1e-3 and last('position') < _FARTHEST)
