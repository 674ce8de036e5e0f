# SPDX-License-Identifier: Apache-2.0
"""How a landing of world `rocket` goes on after its last sample: the planar contact model."""
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
"""Outcomes that are followed; of a touchdown that is too fast the legs would not hold."""
_FASTEST, _FASTEST_SPIN, _FARTHEST = 100.0, 20.0, 1e5
"""m/s, rad/s and m from the pad with which no rocket touches down"""
_LIGHTEST, _HEAVIEST, _STRONGEST = 0.1, 1e9, 10.0
"""kg, kg and a factor: no conditions make lighter rockets, heavier ones, or more gravity"""
_GRAVITY = 'gravity_factor'


def follow(flights: Sequence[Trajectory], stage: WorldInfo) -> list[Settling | None]:
    """Return what becomes of rockets after their flights; None where that is not asked.

    They settle together, which takes little longer than the slowest of them alone.

    :param stage: of any world; only flights of `rocket` are followed, others end at rest.
    """
    ends: list[Settling | None] = [None] * len(flights)
    chosen = [
        place for place, flight in enumerate(flights)
        if stage.world == 'rocket' and flight.outcome in _SETTLE and _may_be(flight)
        and 0.0 <= _gravity_factor(flight, stage) <= _STRONGEST]
    if not chosen:
        return ends
    last = Trajectory(0, 0, 0, '', np.stack([
        flights[place].values[-1, :WIDTH] for place in chosen]))
    settled = settle(
        frames.vector_from_ros(last.position), frames.quaternion_from_ros(last.orientation),
        frames.vector_from_ros(last.linear_velocity),
        frames.vector_from_ros(last.angular_velocity), last.mass, stage.settings, trajectory=True,
        gravity=stage.settings['gravity'] * np.array([
            _gravity_factor(flights[place], stage) for place in chosen]))
    course, names = settled.trajectory, settled.names()
    assert course is not None
    for lane, place in enumerate(chosen):
        # The first moment is that of touchdown, which the flight has.
        own = slice(1, int(course.length[lane])), lane
        count = int(course.length[lane]) - 1
        ends[place] = Settling.build(
            names[lane], frames.vector_to_ros(course.position[own]),
            frames.quaternion_to_ros(course.orientation[own]), flights[place].layout,
            linear_velocity=frames.vector_to_ros(course.linear_velocity[own]),
            angular_velocity=frames.vector_to_ros(course.angular_velocity[own]),
            fuel=np.full(count, last.fuel[lane]), mass=np.full(count, last.mass[lane]))
    return ends


def _gravity_factor(flight: Trajectory, stage: WorldInfo) -> float:
    """Return the factor of gravity that was drawn for a flight."""
    names = stage.condition_names
    known = _GRAVITY in names and flight.layout.conditions == len(names)
    return float(flight.conditions[-1, names.index(_GRAVITY)]) if known else 1.0


def _may_be(flight: Trajectory) -> bool:
    """Return whether the contact model has an answer: anybody may say what a rocket ends with."""
    def last(name: str) -> float:
        return float(np.linalg.norm(flight.values[-1, FIELDS[name]]))

    return bool(
        not flight.layout.legs and not flight.layout.heights
        and _LIGHTEST <= flight.mass[-1] <= _HEAVIEST and flight.fuel[-1] >= 0.0
        and last('linear_velocity') < _FASTEST and last('angular_velocity') < _FASTEST_SPIN
        and abs(last('orientation') - 1.0) < 1e-3 and last('position') < _FARTHEST)
