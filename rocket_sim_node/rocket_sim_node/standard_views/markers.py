# SPDX-License-Identifier: Apache-2.0
"""Markers around a rocket: flame, path, wind, terrain, and a label with its figures."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.palette import Colour
from rocket_sim_node.palette import words
from rocket_sim_node.recording.drawing.geometry import revolve
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.standard_views.motion import RocketView

F64 = NDArray[np.float64]

PATH_POINTS = 400
"""Maximum points of a path; when there are more, every other one is left out."""
MOST_ENDS = 100
"""Number of episodes whose ends are marked, the newest ones."""
_FLAME_LENGTH = 5.0, 20.0
"""m of flame when the engine is on, and additional m at full throttle, for a vehicle as drawn."""
_LANDER_FLAME = 0.2
"""Size of the lander's flame, in that of the rocket's."""
_WIND = 25.0
"""m of arrow for 1 m/s^2, for a vehicle as drawn."""
_CORNERS = 64


class Shape(Enum):
    """Kinds of markers; the values are those of `visualization_msgs/Marker`."""

    ARROW = 0
    CYLINDER = 3
    LINE_STRIP = 4
    LINE_LIST = 5
    SPHERE_LIST = 7
    TEXT = 9
    TRIANGLES = 11


@dataclass(frozen=True)
class Marker:
    """One marker, found again by `namespace` and `row`; a hidden one is removed.

    `points` is `(n, 3)`, m, in the frame of the marker; `colours` has one colour or one for each
    point, as do messages; `opacity` is 0 to 1. `size` is `scale` of the message.
    """

    namespace: str
    shape: Shape
    size: tuple[float, float, float] = (1.0, 1.0, 1.0)
    colours: tuple[Colour, ...] = (palette.WHITE,)
    points: F64 | None = None
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    text: str = ''
    opacity: float = 1.0
    on_body: bool = False
    hidden: bool = False


def scene(info: WorldInfo, ends: Ends) -> list[Marker]:
    """Return what stands still: the pad, the circle within which a landing counts, and ends."""
    limit = info.landed_distance
    thick = 0.02 * limit
    angle = np.linspace(0.0, 2 * np.pi, _CORNERS + 1)
    circle = limit * np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1)
    cross = np.array(((-0.3, 0, 0), (0.3, 0, 0), (0, -0.3, 0), (0, 0.3, 0))) * limit
    return [
        Marker('pad', Shape.CYLINDER, (3.2 * limit, 3.2 * limit, thick), (palette.CONCRETE,),
               position=(0.0, 0.0, -thick)),
        Marker('limit', Shape.LINE_STRIP, (0.05 * limit, 0.0, 0.0), (palette.TARGET,), circle),
        Marker('centre', Shape.LINE_LIST, (0.04 * limit, 0.0, 0.0), (palette.PAINT,), cross),
        ends.marker(info),
    ]


class Ends:
    """Where the newest episodes ended, and how."""

    def __init__(self) -> None:
        """Start without any."""
        self._found: deque[tuple[F64, str]] = deque(maxlen=MOST_ENDS)

    def add(self, view: RocketView) -> None:
        """Add the end of an episode."""
        self._found.append((view.position, view.outcome))

    def clear(self) -> None:
        """Forget them, as another world begins."""
        self._found.clear()

    def marker(self, info: WorldInfo) -> Marker:
        """Return a sphere at the feet of each, also in the air, coloured by its outcome."""
        colours = palette.outcome_colours(info.outcomes)
        points = np.array([position for position, _ in self._found]).reshape(-1, 3)
        points[:, 2] = np.maximum(points[:, 2] - info.unit, 0.0)
        size = 0.12 * info.landed_distance
        return Marker(
            'outcomes', Shape.SPHERE_LIST, (size, size, size), tuple(
                colours.get(outcome, palette.GREY) for _, outcome in self._found), points,
            hidden=not self._found)


class RocketMarkers:
    """Markers of one rocket, of its current episode."""

    def __init__(self, info: WorldInfo) -> None:
        """Start without a path.

        :param info: the world that it flies in.
        """
        self._info = info
        self._scale = info.scale
        lander = info.world == 'lunar_lander'
        self._flame_scale = _LANDER_FLAME if lander else info.scale
        self._flame_at = -13.0 / 30.0 if lander else rocket_model.NOZZLE_EXIT * info.scale
        self._nose = 1.0 if lander else rocket_model.NOSE * info.scale
        self._text = 0.5 if lander else 6.0 * info.scale
        self._width = 0.05 if lander else 0.6 * info.scale
        self._path: list[tuple[F64, Colour]] = []
        self._stride, self._seen = 1, 0
        # Its profile, 1 m long; eight sides are enough for what flickers.
        self._flame = revolve((
            (0.02, -1.0, (248, 126, 30)), (0.66, -0.25, (255, 214, 130)),
            (0.55, 0.0, (255, 255, 255))), 8)

    def add(self, view: RocketView) -> None:
        """Extend the path by a state."""
        if view.begins:
            self._path, self._stride, self._seen = [], 1, 0
        burns = view.throttle > 0.0
        if self._seen % self._stride == 0 or view.outcome:
            self._path.append((view.position, palette.BURN if burns else palette.FALL))
        self._seen += 1
        if len(self._path) > PATH_POINTS:
            del self._path[1::2]
            self._stride *= 2

    def of(self, view: RocketView) -> list[Marker]:
        """Return the markers at a state; it has been added."""
        return [
            self._flame_marker(view), self._path_marker(), self._wind_marker(view),
            self._label(view), self._terrain_marker(view)]

    def _flame_marker(self, view: RocketView) -> Marker:
        size = self._flame_scale
        length = (_FLAME_LENGTH[0] + _FLAME_LENGTH[1] * view.throttle) * size
        corners = self._flame.triangle.ravel()
        points = self._flame.position[corners].astype(np.float64) * (
            1.5 * size, 1.5 * size, length)
        return Marker(
            'flame', Shape.TRIANGLES, colours=tuple(
                map(tuple, self._flame.colour[corners].tolist())),
            points=points + (0.0, 0.0, self._flame_at), opacity=0.85, on_body=True,
            hidden=view.throttle <= 0.0 or bool(view.outcome))

    def _path_marker(self) -> Marker:
        return Marker(
            'path', Shape.LINE_STRIP, (self._width, 0.0, 0.0),
            tuple(colour for _, colour in self._path),
            np.array([position for position, _ in self._path]), hidden=len(self._path) < 2)

    def _wind_marker(self, view: RocketView) -> Marker:
        start = view.position + (0.0, 0.0, self._nose / 2)
        return Marker(
            'wind', Shape.ARROW, (self._width, 2 * self._width, 3 * self._width),
            (palette.YELLOW,), np.stack((start, start + _WIND * self._scale * view.disturbance)),
            hidden=not view.disturbance.any())

    def _label(self, view: RocketView) -> Marker:
        speed = float(np.linalg.norm(view.velocity))
        x, y, z = view.position.tolist()
        lines = [f'rocket {view.row}, episode {view.episode}', f'{z:.1f} m  {speed:.1f} m/s']
        if self._info.fuel:
            lines.append(f'fuel {view.fuel:.0f} kg')
        colour = palette.WHITE
        if view.outcome:
            lines.append(words(view.outcome))
            colour = palette.light(palette.outcome_colours(self._info.outcomes).get(
                view.outcome, palette.GREY))
        return Marker(
            'label', Shape.TEXT, (0.0, 0.0, self._text), (colour,),
            position=(x, y, z + self._nose + 3 * self._text), text='\n'.join(lines))

    def _terrain_marker(self, view: RocketView) -> Marker:
        across = np.linspace(-1.0, 1.0, len(view.terrain)) * self._info.field_half_width
        return Marker(
            'terrain', Shape.LINE_STRIP, (0.08, 0.0, 0.0), (palette.GREY,),
            np.stack((across, 0.0 * across, view.terrain), axis=1),
            hidden=len(view.terrain) < 2)
