# SPDX-License-Identifier: Apache-2.0
"""Plots of a comparison: one line per pilot, in the pilot's colour."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.palette import Colour
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.scene.sceneries import Scenery
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

F64 = NDArray[np.float64]

COLOURS: tuple[Colour, ...] = (
    palette.WHITE, palette.ORANGE, palette.SKY, palette.PURPLE, palette.YELLOW, palette.GREEN)
"""Colours of the pilots, in order; the first pilot is the reference."""
_WIDTHS = (6.5, 4.5, 2.0)
"""Line widths of the pilots; they differ so that overlapping lines stay visible."""


class Named(Protocol):
    """Interface of a compared pilot that plots need."""

    @property
    def key(self) -> str:
        """Its entity path."""
        ...

    @property
    def name(self) -> str:
        """Its label in legends."""
        ...


def _plot(title: str, name: str, values: Callable[[Trajectory, WorldInfo], F64]) -> Plot:
    """Return a plot of one line; the pilot determines its name and colour."""
    return Plot(title, name, (), (), lambda flight, info: (values(flight, info),))


HEIGHT = _plot('Height (m)', 'height', lambda f, s: f.position[:, 2] - s.touchdown_height)
SPEED = _plot('Speed (m/s)', 'speed', lambda f, _: f.speed)
TILT = _plot('Tilt (deg)', 'tilt', lambda f, _: f.tilt)
THROTTLE = _plot('Throttle (%)', 'throttle', lambda f, _: 100.0 * f.throttle)
FUEL = _plot('Fuel used (kg)', 'fuel_used', lambda f, _: f.fuel[0] - f.fuel)
RETURN = _plot(
    'Return so far', 'return', lambda f, _: np.cumsum(np.append(0.0, f.reward[1:])))


def plots(info: WorldInfo) -> tuple[Plot, ...]:
    """Return the five plots of a world's comparison."""
    return HEIGHT, SPEED, TILT, THROTTLE, FUEL if info.fuel > 0 else RETURN


def look(info: WorldInfo) -> Scenery:
    """Return the scenery of a world with these plots instead of its own."""
    return replace(scenery(info.world), plots=plots(info), unseen=())


def entity(side: Named) -> str:
    """Return the plotted entity."""
    return f'/{side.key}{entities.ROCKET}'


def log_styles(stream: rr.RecordingStream, sides: Sequence[Named]) -> None:
    """Log the lines' styles, once for all plots."""
    for number, side in enumerate(sides):
        stream.log(entity(side), rr.SeriesLines(
            names=[side.name], colors=[COLOURS[number % len(COLOURS)]],
            widths=[_WIDTHS[min(number, len(_WIDTHS) - 1)]]), static=True)
