# SPDX-License-Identifier: Apache-2.0
"""The plots of a flight: what their lines are, and what they look like."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording.drawing import palette
from rocket_sim_node.recording.drawing.palette import Colour
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.worlds.lunar.vehicle import SIDE_ENGINE_AWAY
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings

F64 = NDArray[np.float64]
STANDARD_GRAVITY = 9.81
_MOST = np.finfo(np.float16).max

SAMPLE = 'Flight:sample'
"""the component of a rocket's entity that holds all that is plotted of it, a record in each row;
one of its own for each plot would cost 4 bytes a row more, and its place in the file's index"""
UNUSUAL = 'Flight:unusual'
"""the same of flights whose conditions are not nominal, beside their samples"""
STYLES = {
    SAMPLE: {'SeriesLines:names': 'Flight:names', 'SeriesLines:colors': 'Flight:colors'},
    UNUSUAL: {
        'SeriesLines:names': 'Flight:unusual_names', 'SeriesLines:colors': 'Flight:unusual_colors',
    },
}
"""where the viewer finds what the lines are called and look like, with the fields of a record"""


@dataclass(frozen=True)
class Plot:
    """A plot of the rocket's entity: one field of its records, and its lines' names and colours.

    `records` is :data:`SAMPLE` or :data:`UNUSUAL`. `lines` gives the values of a flight of n
    samples, one `(n,)` for each line. Where `rough` they are stored with half precision, 0.05 %:
    what follows from other components need only be drawn.
    """

    title: str
    name: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    lines: Callable[[Trajectory, WorldInfo], tuple[F64, ...]]
    rough: bool = False
    records: str = SAMPLE

    def table(
        self, flight: Trajectory, stage: WorldInfo,
    ) -> NDArray[np.float32] | NDArray[np.float16]:
        """Return the values of n samples as `(n + 1, lines)`; the last row is a gap."""
        lines = self.lines(flight, stage)
        table = np.full((len(flight) + 1, len(lines)), np.nan, np.float32)
        table[:-1] = np.stack(lines, axis=1)
        return table.clip(-_MOST, _MOST).astype(np.float16) if self.rough else table

    @property
    def selector(self) -> str:
        """What picks the values of its lines from a record, in the viewer's words."""
        return f'.{self.name}[]'


def weights(flight: Trajectory, stage: WorldInfo) -> F64:
    """Return the force of the ground `(n, 3)`, in weights of the vehicle as it started."""
    gravity = stage.settings.get('gravity') or STANDARD_GRAVITY
    return flight.contact_force / max(float(flight.mass[0]) * gravity, 1e-9)


def _motion(flight: Trajectory, stage: WorldInfo) -> tuple[F64, ...]:
    return flight.position[:, 2] - stage.touchdown_height, flight.speed


def _engine(flight: Trajectory, stage: WorldInfo) -> tuple[F64, ...]:
    return 100.0 * flight.throttle, 100.0 * flight.fuel / max(stage.fuel, 1e-9)


def _side_engines(flight: Trajectory, stage: WorldInfo) -> tuple[F64, ...]:
    """Return main and side engines, %: those have no throttle of their own, only a force."""
    power = stage.settings.get('side_engine_power', LunarSettings.side_engine_power)
    most = max(power / stage.dt * SIDE_ENGINE_AWAY, 1e-9)
    return 100.0 * flight.throttle, 100.0 * flight.lateral_thrust / most


def _reward(flight: Trajectory, stage: WorldInfo) -> tuple[F64, ...]:
    # What stands at the first sample belongs to no step of this flight.
    reward = np.append(0.0, flight.reward[1:])
    return np.cumsum(reward), reward


def _contact(flight: Trajectory, stage: WorldInfo) -> tuple[F64, ...]:
    return (np.linalg.norm(weights(flight, stage), axis=1),)


MOTION = Plot(
    'Height and speed', 'motion', ('height (m)', 'speed (m/s)'), (palette.SKY, palette.ORANGE),
    _motion, rough=True)
TILT = Plot(
    'Tilt (deg)', 'tilt', ('tilt',), (palette.PURPLE,), lambda flight, _: (flight.tilt,),
    rough=True)
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
COMMANDED = Plot(
    'Commanded throttle (%)', 'commanded', ('commanded',), (palette.GREY,),
    lambda flight, _: (100.0 * flight.commanded_throttle,), rough=True, records=UNUSUAL)
DISTURBANCE = Plot(
    'Wind and gusts (m/s²)', 'disturbance', ('along x', 'along y'), (palette.SKY, palette.ORANGE),
    lambda flight, _: (flight.disturbance[:, 0], flight.disturbance[:, 1]), rough=True,
    records=UNUSUAL)
UNUSUALS = (COMMANDED, DISTURBANCE)
"""The fields of an unusual flight's records."""


def _records(fields: Mapping[str, tuple[pa.Array, int]]) -> pa.StructArray:
    """Return records: by name the values of all records, one after another, and how many each."""
    return pa.StructArray.from_arrays(
        [pa.FixedSizeListArray.from_arrays(values, width) for values, width in fields.values()],
        names=list(fields))


def columns(
    plots: tuple[Plot, ...], flight: Trajectory, stage: WorldInfo,
) -> list[rr.ComponentColumn]:
    """Return n samples as a column of n + 1 rows; the last is a gap in the lines of the plots.

    :param plots: all those of one kind of records.
    """
    tables = {plot.name: plot.table(flight, stage) for plot in plots}
    # As Arrow's arrays: Rerun would make a Python list of each number of NumPy's.
    records = _records({
        name: (pa.array(table.ravel()), table.shape[1]) for name, table in tables.items()})
    return list(rr.DynamicArchetype.columns('Flight', components={
        _field(plots[0].records): records}))


def _field(component: str) -> str:
    return component.removeprefix('Flight:')


def log_styles(stream: rr.RecordingStream, entity: str, plots: tuple[Plot, ...]) -> None:
    """Log how the lines of all plots look; it costs a third of what it would in the layout.

    :param plots: all those of one kind of records.
    """
    styles = STYLES[plots[0].records]
    colours = {
        plot.name: pa.array([rr.encodings.Rgba32(c).rgba for c in plot.colours], pa.uint32())
        for plot in plots}
    stream.log(
        entity, rr.SeriesLines.from_fields(widths=[2.0]),
        rr.DynamicArchetype('Flight', components={
            _field(styles['SeriesLines:names']): _records({
                p.name: (pa.array(p.names), len(p.names)) for p in plots}),
            _field(styles['SeriesLines:colors']): _records({
                name: (c, len(c)) for name, c in colours.items()})}),
        static=True)
