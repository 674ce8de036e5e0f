# SPDX-License-Identifier: Apache-2.0
"""The plots of a flight: what their lines are, and what they look like."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording import palette
from rocket_sim_node.recording.flight import Flight
from rocket_sim_node.recording.palette import Colour
from rocket_sim_node.recording.stage import Stage
from rocket_sim_node.worlds.lunar_vehicle import SIDE_ENGINE_AWAY
from rocket_sim_node.worlds.lunar_vehicle import LunarSettings

F64 = NDArray[np.float64]
STANDARD_GRAVITY = 9.81


@dataclass(frozen=True)
class Plot:
    """A plot of the rocket's entity: one component, and its lines' names and colours.

    `lines` gives the values of a flight of n samples, one `(n,)` for each line.
    """

    title: str
    name: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    lines: Callable[[Flight, Stage], tuple[F64, ...]]

    @property
    def component(self) -> str:
        """The component's name in a recording."""
        return f'Flight:{self.name}'


def weights(flight: Flight, stage: Stage) -> F64:
    """Return the force of the ground `(n, 3)`, in weights of the vehicle as it started."""
    gravity = stage.settings.get('gravity') or STANDARD_GRAVITY
    return flight.contact_force / max(float(flight.mass[0]) * gravity, 1e-9)


def _motion(flight: Flight, stage: Stage) -> tuple[F64, ...]:
    return flight.position[:, 2] - stage.touchdown_height, flight.speed


def _engine(flight: Flight, stage: Stage) -> tuple[F64, ...]:
    return 100.0 * flight.throttle, 100.0 * flight.fuel / max(stage.fuel, 1e-9)


def _side_engines(flight: Flight, stage: Stage) -> tuple[F64, ...]:
    """Return main and side engines, %: those have no throttle of their own, only a force."""
    power = stage.settings.get('side_engine_power', LunarSettings.side_engine_power)
    most = max(power / stage.dt * SIDE_ENGINE_AWAY, 1e-9)
    return 100.0 * flight.throttle, 100.0 * flight.lateral_thrust / most


def _reward(flight: Flight, stage: Stage) -> tuple[F64, ...]:
    # What stands at the first sample belongs to no step of this flight.
    reward = np.append(0.0, flight.reward[1:])
    return np.cumsum(reward), reward


def _contact(flight: Flight, stage: Stage) -> tuple[F64, ...]:
    return (np.linalg.norm(weights(flight, stage), axis=1),)


MOTION = Plot(
    'Height and speed', 'motion', ('height (m)', 'speed (m/s)'), (palette.SKY, palette.ORANGE),
    _motion)
TILT = Plot(
    'Tilt (deg)', 'tilt', ('tilt',), (palette.PURPLE,), lambda flight, _: (flight.tilt,))
ENGINE = Plot(
    'Throttle and fuel (%)', 'engine', ('throttle', 'fuel'), (palette.BURN, palette.SKY), _engine)
ENGINES = Plot(
    'Main and side engines (%)', 'engine', ('main', 'side, to the right'),
    (palette.BURN, palette.SKY), _side_engines)
REWARD = Plot(
    'Reward', 'reward', ('return so far', 'reward of the step'), (palette.GREEN, palette.GREY),
    _reward)
CONTACT = Plot(
    'Force of the ground (weights)', 'contact', ('force',), (palette.VERMILION,), _contact)


def columns(
    plots: tuple[Plot, ...], flight: Flight, stage: Stage,
) -> list[rr.ComponentColumn]:
    """Return the plots of n samples as columns of n + 1 rows; the last is a gap in their lines."""
    made: list[rr.ComponentColumn] = []
    for plot in plots:
        lines = plot.lines(flight, stage)
        table = np.full((len(flight) + 1, len(lines)), np.nan, np.float32)
        table[:-1] = np.stack(lines, axis=1)
        # As Arrow's array: Rerun would make a Python list of each number of NumPy's.
        made += rr.DynamicArchetype.columns(
            'Flight', components={plot.name: pa.array(table.ravel())},
        ).partition([len(lines)] * len(table))
    return made
