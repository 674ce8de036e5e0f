# SPDX-License-Identifier: Apache-2.0
"""Geometry of the rocket's legs and hull, and its pymunk body and shapes.

In a vertical plane the vehicle is one rigid body: deployed legs do not move against the hull. Flat
ground can only be touched by the corners of a body's convex hull, which are the two feet and
corners of the hull, so the struts between need no shapes.
"""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass

import pymunk

from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.pymunk_batch.lane_block import LANES
from rocket_sim_node.worlds.pymunk_batch.lane_block import Parts
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

LEFT, RIGHT = 0, 1
"""Indices of the feet, at negative and at positive x."""

_BOTTOM = 2.4
"""m, lower end of the hull below the origin; at most half of the legs' height."""
_CLEARANCE = 0.5
"""m, minimum height of the hull above the feet: a step brings the feet into the ground before
contact is found, and a hull so low that it gets there, too, would always tip the rocket over."""
_OUTLINE = ((1.70, None), (1.85, -1.6), (1.85, 36.2), (1.25, 37.5))
"""m, corners of the hull: half-width and height, None for the bottom."""
_VEHICLE, _GROUND = 0x2, 0x1


@dataclass(frozen=True)
class LegSettings:
    """Contact properties of the feet, and the criteria for the end of a touchdown."""

    stance: float = setting(
        6.7, 'm', 'distance of the feet from the axis; the legs are 9.5 m long, at 45 deg to '
        'it', 0.1, 1e3)
    foot_friction: float = setting(0.6, '', 'coefficient of friction of the feet', 0.0, 10.0)
    # Higher values, with friction, would add energy at oblique impacts: restitution is Newton's.
    foot_restitution: float = setting(
        0.1, '', 'coefficient of restitution of the feet', 0.0, 0.6)
    hull_friction: float = setting(0.4, '', 'coefficient of friction of the hull', 0.0, 10.0)
    hull_restitution: float = setting(
        0.1, '', 'coefficient of restitution of the hull', 0.0, 0.6)
    engine_cutoff: bool = setting(
        True, '', 'whether the first foot that touches cuts engine and RCS')
    touchdown_limit: float = setting(
        5.0, 's', 'maximum time from the first contact to rest; a longer one is a crash', 0.0, 1e3)
    rest_time: float = setting(
        0.5, 's', 'time standing still after which the rocket is at rest', 0.0, 100.0)
    rest_speed: float = setting(0.05, 'm/s', 'maximum speed of standing still', 1e-6, 10.0)
    rest_spin: float = setting(
        0.5, 'deg/s', 'maximum angular velocity of standing still', 1e-6, 360.0)


@dataclass(frozen=True)
class PlanarSettings(LegSettings, RocketSettings):
    """All settings of world `rocket_planar`."""

    spawn_heading: float = setting(
        0.0, 'deg', "rotation of the pilot's axes about the vertical, plus or minus, drawn for "
        'each episode; 0: the plane is x-y', 0.0, 180.0)


def feet(settings: PlanarSettings) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the positions of the left and right foot relative to the origin, m."""
    height = -settings.touchdown_height
    return (-settings.stance, height), (settings.stance, height)


def foot_height(
    origin: F64 | float, lean: F64, upright: F64, settings: Mapping[str, float],
) -> F64:
    """Return the height of the lower foot, m.

    :param origin: height of the origin, m.
    :param lean: sine of the tilt, 0 or more, and `upright` its cosine.
    :param settings: of a world of rockets with feet.
    """
    lower: F64 = origin - settings['stance'] * lean - settings['touchdown_height'] * upright
    return lower


def hull_bottom(settings: PlanarSettings) -> float:
    """Return the height of the hull's lower end relative to the origin, m."""
    legs = settings.touchdown_height
    return max(-min(_BOTTOM, legs / 2), _CLEARANCE - legs)


def hull(settings: PlanarSettings) -> tuple[tuple[float, float], ...]:
    """Return the hull's corners relative to the origin, m."""
    bottom = hull_bottom(settings)
    side = [(x, bottom if y is None else max(y, bottom)) for x, y in _OUTLINE]
    return (*side, *((-x, y) for x, y in reversed(side)))


class PlanarDesign:
    """A `Design` of one body with two feet and a hull, above flat ground."""

    bodies = 1
    lane_width = 128.0
    cell = 40.0

    def __init__(self, settings: PlanarSettings) -> None:
        """Derive the dimensions from the settings."""
        self._settings = settings
        # Thick enough that no foot passes through within a step.
        self._depth = max(5.0, 2 * settings.landed_speed * settings.dt)
        self._reach = 2 * settings.range_limit + settings.stance + 1000.0

    def vehicle(self) -> Parts:
        """Return the body, its left foot, its right foot and its hull."""
        s = self._settings
        body = pymunk.Body(s.dry_mass, s.inertia)
        shapes: list[pymunk.Shape] = [pymunk.Circle(body, 0.0, place) for place in feet(s)]
        for foot in shapes:
            foot.friction, foot.elasticity = s.foot_friction, s.foot_restitution
        shapes.append(pymunk.Poly(body, hull(s)))
        shapes[-1].friction, shapes[-1].elasticity = s.hull_friction, s.hull_restitution
        for shape in shapes:
            shape.filter = pymunk.ShapeFilter(categories=_VEHICLE, mask=_GROUND)
        return Parts([body], shapes)

    def ground(self, body: pymunk.Body, origin: float) -> Sequence[pymunk.Shape]:
        """Return the ground, one thick plate with its top at y = 0; the first lane's serves all.

        It extends as far as a vehicle can slide before its episode ends.
        """
        if origin:
            return []
        plate = pymunk.Segment(
            body, (-self._reach, -self._depth), (self._reach + LANES * self.lane_width,
                                                 -self._depth), self._depth)
        # pymunk multiplies the coefficients of touching shapes.
        plate.friction = plate.elasticity = 1.0
        plate.filter = pymunk.ShapeFilter(categories=_GROUND, mask=_VEHICLE)
        return [plate]
