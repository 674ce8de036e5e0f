# SPDX-License-Identifier: Apache-2.0
"""Plots of a flight: the values and styles of their lines."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.palette import Colour
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.quantities import QUANTITIES
from rocket_sim_node.telemetry.quantities import Curves
from rocket_sim_node.telemetry.quantities import Quantity
from rocket_sim_node.worlds.lunar.vehicle import SIDE_ENGINE_AWAY
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings

F64 = NDArray[np.float64]
STANDARD_GRAVITY = 9.81
_MOST = np.finfo(np.float16).max

SAMPLE = 'Flight:sample'
"""Component of a rocket's entity with all plotted values, one record per row. A component for each
plot would cost 4 bytes a row more, and an entry in the file's index."""
UNUSUAL = 'Flight:unusual'
"""The same for additional values of flights under conditions that are not nominal."""
STYLES = {
    SAMPLE: {'SeriesLines:names': 'Flight:names', 'SeriesLines:colors': 'Flight:colors'},
    UNUSUAL: {
        'SeriesLines:names': 'Flight:unusual_names', 'SeriesLines:colors': 'Flight:unusual_colors',
    },
}
"""Where the viewer finds names and styles of the lines, beside the records."""


@dataclass(frozen=True)
class Plot:
    """A plot: one field of the rocket's records, and its lines' names and colours.

    `records` is :data:`SAMPLE` or :data:`UNUSUAL`. `lines` gives the values of a flight of n
    samples, one `(n,)` for each line. If `rough`, they are stored with half precision, 0.05 %,
    enough for drawing values that follow from other components. `behind` is the name of the plot
    in whose view it is drawn, if it has none of its own.
    """

    title: str
    name: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    lines: Callable[[Trajectory, WorldInfo], tuple[F64, ...]]
    rough: bool = False
    records: str = SAMPLE
    behind: str = ''

    def table(
        self, flight: Trajectory, info: WorldInfo,
    ) -> NDArray[np.float32] | NDArray[np.float16]:
        """Return the values of n samples as `(n + 1, lines)`; the last row is a gap."""
        lines = self.lines(flight, info)
        table = np.full((len(flight) + 1, len(lines)), np.nan, np.float32)
        table[:-1] = np.stack(lines, axis=1)
        return table.clip(-_MOST, _MOST).astype(np.float16) if self.rough else table

    @property
    def selector(self) -> str:
        """The viewer's query for the values of its lines in a record."""
        return f'.{self.name}[]'


def weights(flight: Trajectory, info: WorldInfo) -> F64:
    """Return the force of the ground `(n, 3)`, in initial weights of the vehicle."""
    gravity = info.settings.get('gravity') or STANDARD_GRAVITY
    return flight.contact_force / max(float(flight.mass[0]) * gravity, 1e-9)


def _motion(flight: Trajectory, info: WorldInfo) -> tuple[F64, ...]:
    return flight.position[:, 2] - info.touchdown_height, flight.speed


def _engine(flight: Trajectory, info: WorldInfo) -> tuple[F64, ...]:
    return 100.0 * flight.throttle, 100.0 * flight.fuel / max(info.fuel, 1e-9)


def _side_engines(flight: Trajectory, info: WorldInfo) -> tuple[F64, ...]:
    """Return main and side engines, %; side engines have a force but no throttle of their own."""
    power = info.settings.get('side_engine_power', LunarSettings.side_engine_power)
    most = max(power / info.dt * SIDE_ENGINE_AWAY, 1e-9)
    return 100.0 * flight.throttle, 100.0 * flight.lateral_thrust / most


def _reward(flight: Trajectory, info: WorldInfo) -> tuple[F64, ...]:
    # The first sample's reward belongs to no step of this flight.
    reward = np.append(0.0, flight.reward[1:])
    return np.cumsum(reward), reward


def _contact(flight: Trajectory, info: WorldInfo) -> tuple[F64, ...]:
    return (np.linalg.norm(weights(flight, info), axis=1),)


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


def _of(quantity: Quantity, curves: Curves) -> Plot:
    """Return the plot that the table of quantities describes."""
    def lines(flight: Trajectory, _: WorldInfo) -> tuple[F64, ...]:
        columns = getattr(flight, quantity.name).reshape(len(flight), -1).T
        return tuple(curves.factor * columns[:len(curves.lines)])

    return Plot(
        curves.title, curves.field, tuple(curves.lines), tuple(curves.lines.values()), lines,
        rough=True, records=UNUSUAL if curves.unusual else SAMPLE, behind=curves.behind)


_QUANTITIES = tuple(
    _of(quantity, quantity.curves) for quantity in QUANTITIES if quantity.curves is not None)
EVERYWHERE = tuple(plot for plot in _QUANTITIES if plot.records == SAMPLE)
"""Plots of quantities for every flight, in every world."""
UNUSUALS = tuple(plot for plot in _QUANTITIES if plot.records == UNUSUAL)
"""Plots of the records of flights under conditions that are not nominal."""


def _records(fields: Mapping[str, tuple[pa.Array, int]]) -> pa.StructArray:
    """Return records; per field, the values of all records concatenated and the number of each."""
    return pa.StructArray.from_arrays(
        [pa.FixedSizeListArray.from_arrays(values, width) for values, width in fields.values()],
        names=list(fields))


def columns(
    plots: tuple[Plot, ...], flight: Trajectory, info: WorldInfo,
) -> list[rr.ComponentColumn]:
    """Return n samples as a column of n + 1 rows; the last is a gap in the lines of the plots.

    :param plots: all those of one kind of records.
    """
    tables = {plot.name: plot.table(flight, info) for plot in plots}
    # As Arrow arrays: Rerun would convert NumPy arrays to Python lists.
    records = _records({
        name: (pa.array(table.ravel()), table.shape[1]) for name, table in tables.items()})
    return list(rr.DynamicArchetype.columns('Flight', components={
        _field(plots[0].records): records}))


def _field(component: str) -> str:
    return component.removeprefix('Flight:')


def log_styles(stream: rr.RecordingStream, entity: str, plots: tuple[Plot, ...]) -> None:
    """Log the styles of all plots' lines; costs a third of the same in the layout.

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
