# SPDX-License-Identifier: Apache-2.0
"""Small pictures of rockets and landers, for `render_mode='rgb_array'`."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL import ImageDraw

from rocket_sim_node import palette
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.lunar import vehicle as lunar

_ROCKET_SIZE, _ROCKET_SCALE = (400, 500), 2.0
"""Pixels; pixels per m."""
_LANDER_SIZE, _LANDER_SCALE = (600, 400), 30.0
"""Those of Gymnasium's LunarLander."""
_MARGIN = 60
"""Pixels of ground below y = 0, and of air that the camera keeps around the rocket."""
_HULL = ((-1.85, -2.4), (1.85, -2.4), (1.85, 36.2), (1.25, 37.5), (-1.25, 37.5), (-1.85, 36.2))
_FEET = (-6.7, 6.7)
_FLAME = 25.0
"""m, of the rocket's engine at full throttle."""
_LANDER_FLAME = 1.5
"""m, of the lander's main engine."""

Points = NDArray[np.float64]


class Camera:
    """Draws the x-y plane of one environment, seen from the side."""

    def __init__(self, spec: WorldSpec) -> None:
        """Draw what does not move.

        :param spec: the world.
        """
        self._lander = spec.name == 'lunar_lander'
        self._size = _LANDER_SIZE if self._lander else _ROCKET_SIZE
        self._scale = _LANDER_SCALE if self._lander else _ROCKET_SCALE
        self._foot = -spec.settings.get('touchdown_height', 0.0)
        self._pad = spec.settings.get('landed_distance', 0.0)

    def frame(self, states: Telemetry, index: int) -> NDArray[np.uint8]:
        """Return the picture of one of the states, `(height, width, 3)` uint8.

        :param states: of S environments.
        :param index: which, 0 to S - 1.
        """
        image = Image.new('RGB', self._size, palette.BACKGROUND)
        draw = ImageDraw.Draw(image)
        if self._lander:
            self._draw_lander(draw, states, index)
        else:
            self._draw_rocket(draw, states, index)
        speed = float(np.linalg.norm(states.linear_velocity[index]))
        draw.text(
            (6, 4), f'{states.time[index]:.2f} s   {speed:.1f} m/s   '
            f'{max(states.position[index, 1], 0.0):.1f} m', fill=palette.WHITE)
        return np.array(image)  # a copy, which the caller may write to

    def _draw_rocket(self, draw: ImageDraw.ImageDraw, states: Telemetry, index: int) -> None:
        width, height = self._size
        x, y, _ = states.position[index].tolist()
        # The camera follows a rocket that would leave the picture.
        aside = (width / 2 - _MARGIN) / self._scale
        above = (height - 2.5 * _MARGIN) / self._scale
        shift = np.array([x - np.clip(x, -aside, aside), max(y - above, 0.0)])
        origin = np.array([width / 2, height - _MARGIN])

        def pixels(points: Points) -> list[tuple[float, float]]:
            placed = origin + (points - shift) * (self._scale, -self._scale)
            return [(float(a), float(b)) for a, b in placed]

        ground = pixels(np.array([[0.0, 0.0]]))[0][1]
        draw.rectangle((0, ground, width, height), fill=palette.SOIL)
        left, right = pixels(np.array([[-self._pad, 0.0], [self._pad, 0.0]]))
        draw.rectangle((left[0], ground, right[0], ground + 6), fill=palette.CONCRETE)
        up = _up(states.orientation[index])
        # Seen from the side, a rocket that leans towards the viewer is shorter, not wider.
        axes = np.array([np.array([up[1], -up[0]]) / max(np.hypot(*up), 1e-9), up])

        def body(points: Points) -> list[tuple[float, float]]:
            return pixels(np.array([x, y]) + points @ axes)

        throttle = float(states.throttle[index])
        if throttle > 0:
            draw.polygon(body(np.array(
                [[-1.5, -2.4], [1.5, -2.4], [0.0, -2.4 - _FLAME * throttle]])), fill=palette.BURN)
        for foot in _FEET:
            draw.line(body(np.array([[np.sign(foot) * 1.85, 3.0], [foot, self._foot]])),
                      fill=palette.GREY, width=2)
        draw.polygon(body(np.array(_HULL)), fill=palette.PAINT)

    def _draw_lander(self, draw: ImageDraw.ImageDraw, states: Telemetry, index: int) -> None:
        width, height = self._size
        origin = np.array([width / 2, height - lunar.PAD_GROUND * self._scale])

        def pixels(points: Points) -> list[tuple[float, float]]:
            placed = origin + points * (self._scale, -self._scale)
            return [(float(a), float(b)) for a, b in placed]

        terrain = states.terrain[index]
        edges = np.linspace(-lunar.HALF_WIDTH, lunar.HALF_WIDTH, len(terrain))
        draw.polygon([
            (0.0, float(height)), *pixels(np.stack((edges, terrain), axis=1)),
            (float(width), float(height))], fill=palette.SOIL)
        draw.line(pixels(edges[[4, 6], None] * [[1.0, 0.0]]), fill=palette.TARGET, width=3)
        x, y, _ = states.position[index].tolist()
        up = _up(states.orientation[index])
        axes = np.array([[up[1], -up[0]], up])

        def body(points: Points) -> list[tuple[float, float]]:
            return pixels(np.array([x, y]) + points @ axes)

        main, side = float(states.throttle[index]), float(states.lateral_thrust[index])
        if main > 0:
            draw.polygon(body(np.array(
                [[-0.2, -0.3], [0.2, -0.3], [0.0, -0.3 - _LANDER_FLAME * main]])),
                fill=palette.BURN)
        if side:
            where = -np.sign(side) * lunar.SIDE_ENGINE_AWAY
            draw.line(body(np.array([
                [where, lunar.SIDE_ENGINE_HEIGHT], [2.5 * where, lunar.SIDE_ENGINE_HEIGHT]])),
                fill=palette.BURN, width=4)
        for leg, sign in enumerate((-1.0, 1.0)):
            angle = float(states.leg_angle[index, leg]) + lunar.LEG_INNER
            centre = np.array(lunar.leg_offset(sign, angle))
            along = np.array([-np.sin(sign * angle), np.cos(sign * angle)])
            ends = np.array([centre + along * lunar.LEG_HALF_LENGTH,
                             centre - along * lunar.LEG_HALF_LENGTH])
            touching = bool(states.contact[index, leg])
            draw.line(body(ends), fill=palette.GREEN if touching else palette.GREY, width=4)
        draw.polygon(body(np.array(lunar.HULL)), fill=palette.PAINT)


def _up(orientation: Points) -> Points:
    """Return the x-y part of a vehicle's up vector, `(2,)`, from its quaternion x y z w."""
    x, y, z, w = orientation.tolist()
    return np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z)])
