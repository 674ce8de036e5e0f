# SPDX-License-Identifier: Apache-2.0
"""Constants of the lunar lander and its task, and its pymunk bodies and shapes.

Geometry, masses and powers are those of Gymnasium's LunarLander-v3 (Farama Foundation, version
1.4). Lengths are in its metres, each 30 pixels of its rendering.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pymunk

from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.pymunk_batch.lane_block import Parts

_PIXELS = 30.0
HALF_WIDTH = 600.0 / _PIXELS / 2
"""m, of the field."""
HALF_HEIGHT = 400.0 / _PIXELS / 2
"""m, of the field."""
PAD_HEIGHT = HALF_HEIGHT / 2
"""m, height of the flags; the pad's ground is 1 % lower, as smoothing weighs 3 x 0.33."""
PAD_GROUND = 0.99 * PAD_HEIGHT
HULL = tuple((x / _PIXELS, y / _PIXELS) for x, y in (
    (-14, 17), (-17, 0), (-17, -10), (17, -10), (17, 0), (14, 17)))
"""m, corners of the hull relative to its origin, where the legs are hinged."""
LEG_AWAY, LEG_DOWN = 20 / _PIXELS, 18 / _PIXELS
"""m, of a leg's centre from the hinge, in the leg's own frame."""
LEG_HALF_WIDTH, LEG_HALF_LENGTH = 2 / _PIXELS, 8 / _PIXELS
LEG_INNER, LEG_OUTER = 0.35, 0.85
"""rad, range of a leg's angle; the spring holds it at the inner end. Gymnasium has 0.4 and 0.9,
counted from the angle at which it creates legs, 0.05 inwards."""
LEG_START = 0.492
"""rad, initial angle of a leg, at which Box2D leaves it after first joining the parts."""
LEG_PUSHED = -0.05
"""rad, angle at which Gymnasium creates a leg, which counts while the first push acts."""
MAIN_ENGINE_OFFSET = 4 / _PIXELS
SIDE_ENGINE_AWAY = 12 / _PIXELS
SIDE_ENGINE_HEIGHT = 14 / _PIXELS
SIDE_ENGINE_SKEW = 17 / _PIXELS
"""m; like Gymnasium, we use this one along x and the height along y."""
DISPERSION = 1 / _PIXELS
"""m, half-width of the uniform scatter of the engines' points of action."""
START_PUSH = 1000.0
"""N, for one step, half-width along x and y."""
_HULL_DENSITY, _LEG_DENSITY = 5.0, 1.0
_SPRING_TORQUE, _SPRING_RATE = 40.0, 0.3
_SKIN = 0.01
"""m, radius of the corners: Box2D's shapes touch when closer than the sum of their skins."""
# Box2D combines two frictions by the square root of their product, pymunk by the product. The
# ground here has 1, and the others have what Box2D makes of theirs (0.1 hull, 0.2 leg) and 0.1.
_HULL_FRICTION, _LEG_FRICTION = 0.1, (0.2 * 0.1) ** 0.5
_VEHICLE, _GROUND = 0x2, 0x1

LEFT, RIGHT = 1, 2
"""Indices of the leg bodies; 0 is the hull."""
SIDE = {LEFT: -1.0, RIGHT: 1.0}
START_HEIGHT = 2 * HALF_HEIGHT
"""m, height of the hull's origin at the start."""
DROP = START_HEIGHT - PAD_GROUND - LEG_DOWN
"""m, from the start to the height at which a lander stands on the pad."""


@dataclass(frozen=True)
class LunarSettings:
    """Settings of the world; the defaults are Gymnasium's."""

    dt: float = setting(0.02, 's', 'simulated time per step', 1e-3, 0.05)
    continuous: bool = setting(
        False, '', 'whether an action is two numbers, main throttle and lateral, instead of one '
        'of four choices')
    gravity: float = setting(10.0, 'm/s^2', 'gravity', 0.0, 12.0)
    enable_wind: bool = setting(False, '', 'whether wind and turbulence act until a leg touches')
    wind_power: float = setting(15.0, 'N', 'maximum force of the wind', 0.0, 20.0)
    turbulence_power: float = setting(1.5, 'N m', 'maximum torque of the wind', 0.0, 2.0)
    main_engine_power: float = setting(
        13.0, 'N s/m', 'impulse of the main engine per step and metre of its offset, which is '
        '0.13 m',
        0.0, 1e3)
    side_engine_power: float = setting(
        0.6, 'N s/m', 'impulse of a side engine per step and metre of its offset, which is 0.4 '
        'm', 0.0, 1e3)
    spawn_reach: float = setting(
        0.0, 'm', 'maximum start height above touchdown: starts are uniform up to it, above the '
        'pad, with a push in proportion; 0: all start at the top', 0.0, DROP)
    time_limit: float = setting(
        20.0, 's', 'maximum length of an episode; a longer one is truncated', 0.02, 1e5)
    rest_time: float = setting(
        0.5, 's', 'time at rest on the ground after which the lander counts as landed', 0.0, 100.0)
    rest_speed: float = setting(0.01, 'm/s', 'maximum speed of any part at rest', 0.0, 10.0)
    rest_spin: float = setting(
        2.0, 'deg/s', 'maximum angular velocity of any part at rest', 0.0, 360.0)
    reward_crash: float = setting(-100.0, '', 'reward for touching the ground with the hull or '
        'leaving the field',
                                  -1e6, 1e6)
    reward_landed: float = setting(100.0, '', 'reward for coming to rest', -1e6, 1e6)
    reward_main_engine: float = setting(
        -0.3, '', 'reward for a step of the main engine', -1e6, 1e6)
    reward_side_engine: float = setting(-0.03, '', 'reward for a step of a side engine', -1e6, 1e6)


_HULL_SHAPE = pymunk.Poly(None, HULL)
HULL_CENTRE = _HULL_SHAPE.center_of_gravity.y
"""m, height of the hull's centre of gravity above its origin."""
HULL_MASS = _HULL_DENSITY * _HULL_SHAPE.area
HULL_MOMENT = pymunk.moment_for_poly(HULL_MASS, HULL, (0.0, -HULL_CENTRE))
LEG_MASS = _LEG_DENSITY * 4 * LEG_HALF_WIDTH * LEG_HALF_LENGTH
LEG_MOMENT = pymunk.moment_for_box(LEG_MASS, (2 * LEG_HALF_WIDTH, 2 * LEG_HALF_LENGTH))
TOTAL_MASS = HULL_MASS + 2 * LEG_MASS
_BODY_LEG_MASS, _BODY_LEG_MOMENT = 0.25, 0.05
"""kg, kg m^2, of the legs' bodies, see `_shift_mass`."""


def leg_offset(side: float, angle: float) -> tuple[float, float]:
    """Return the position of a leg's centre relative to the origin of an upright hull, m.

    :param side: -1 left, 1 right.
    :param angle: rad, outward rotation of the leg.
    """
    away, down = side * LEG_AWAY, LEG_DOWN
    cos, sin = np.cos(side * angle), np.sin(side * angle)
    return float(away * cos + down * sin), float(away * sin - down * cos)


def _shift_mass() -> tuple[float, float, float]:
    """Return mass, moment and height above its origin of the hull's body.

    Box2D has legs of 0.07 kg under a hull of 4.8 kg, and needs 180 iterations for that. A faster
    iterative solver cannot support a heavy body on parts so light. So mass is shifted from the
    hull to the legs such that the vehicle, with its legs drawn in, keeps its mass, its centre of
    gravity and its moment of inertia: its flight is unchanged.
    """
    x, y = leg_offset(1.0, LEG_INNER)
    centre = (HULL_MASS * HULL_CENTRE + 2 * LEG_MASS * y) / TOTAL_MASS
    arm = x**2 + (y - centre) ** 2
    moment = (
        HULL_MOMENT + HULL_MASS * (HULL_CENTRE - centre) ** 2
        + 2 * (LEG_MOMENT + LEG_MASS * arm))
    mass = TOTAL_MASS - 2 * _BODY_LEG_MASS
    height = (TOTAL_MASS * centre - 2 * _BODY_LEG_MASS * y) / mass
    moment -= mass * (height - centre) ** 2 + 2 * (_BODY_LEG_MOMENT + _BODY_LEG_MASS * arm)
    return mass, moment, height


_BODY_HULL_MASS, _BODY_HULL_MOMENT, BODY_CENTRE = _shift_mass()
"""kg, kg m^2; m, height of the hull body's centre of gravity above the hull's origin."""


class LunarDesign:
    """Hull and two sprung legs, above ten slopes and a floor."""

    bodies = 3
    lane_width = 64.0
    cell = 4.0
    slopes = 10

    def vehicle(self) -> Parts:
        """Return hull, left leg and right leg, hinged at the hull's origin."""
        hull = pymunk.Body(_BODY_HULL_MASS, _BODY_HULL_MOMENT)
        corners = [(x, y - BODY_CENTRE) for x, y in HULL]
        shapes: list[pymunk.Shape] = [pymunk.Poly(hull, corners, radius=_SKIN)]
        shapes[0].friction = _HULL_FRICTION
        bodies, joints = [hull], []
        for body in (LEFT, RIGHT):
            side = SIDE[body]
            leg = pymunk.Body(_BODY_LEG_MASS, _BODY_LEG_MOMENT)
            box = pymunk.Poly.create_box(
                leg, (2 * LEG_HALF_WIDTH, 2 * LEG_HALF_LENGTH), radius=_SKIN)
            box.friction = _LEG_FRICTION
            hinge = pymunk.PivotJoint(
                hull, leg, (0.0, -BODY_CENTRE), (-side * LEG_AWAY, LEG_DOWN))
            stop = pymunk.RotaryLimitJoint(
                hull, leg, *sorted((side * LEG_INNER, side * LEG_OUTER)))
            spring = pymunk.SimpleMotor(hull, leg, side * _SPRING_RATE)
            spring.max_force = _SPRING_TORQUE
            bodies.append(leg)
            shapes.append(box)
            # Solved in this order in each iteration; the last constraint is met best. A spring
            # solved after the stop would push through it.
            joints += [spring, hinge, stop]
        for shape in shapes:
            shape.filter = pymunk.ShapeFilter(categories=_VEHICLE, mask=_GROUND)
        return Parts(bodies, shapes, joints)

    def ground(self, body: pymunk.Body, origin: float) -> Sequence[pymunk.Shape]:
        """Return ten slopes, flat until they are moved, and the floor below them."""
        edges = origin + np.linspace(-HALF_WIDTH, HALF_WIDTH, self.slopes + 1)
        shapes = [
            pymunk.Segment(body, (left, 0.0), (right, 0.0), _SKIN)
            for left, right in [*zip(edges[:-1], edges[1:], strict=True), (edges[0], edges[-1])]]
        for shape in shapes:
            shape.friction = 1.0
            shape.filter = pymunk.ShapeFilter(categories=_GROUND, mask=_VEHICLE)
        return shapes
