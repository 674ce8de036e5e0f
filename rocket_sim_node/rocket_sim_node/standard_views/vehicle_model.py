# SPDX-License-Identifier: Apache-2.0
"""Vehicles as URDF: primitive shapes, and the joints whose positions topic `state` tells."""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.palette import Colour
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.standard_views.motion import RocketView
from rocket_sim_node.worlds.lunar import vehicle as lander

F64 = NDArray[np.float64]
Vector = tuple[float, float, float]

BASE_LINK = 'base_link'
THROTTLE = 'throttle'
"""Joint whose position is the throttle, 0 to 1, and whose effort is the thrust, N."""
_WHITE: Colour = (232, 234, 238)
_DARK: Colour = (38, 40, 46)
_STEEL: Colour = (108, 114, 124)
_HULL: Colour = (142, 120, 226)
_DEPTH = 0.8
"""m, of the lander, which its world has in a plane only."""


@dataclass(frozen=True)
class Shape:
    """A box of size (x, y, z), or a cylinder of size (radius, length) along z; m and rad."""

    size: tuple[float, ...]
    at: Vector
    colour: Colour
    turned: Vector = (0.0, 0.0, 0.0)
    """roll, pitch and yaw"""


@dataclass(frozen=True)
class Joint:
    """A joint of the base link: its child has the name of the joint, with `_link` behind it.

    A sliding joint moves by its position, m, along `axis`; a turning one by `rest` and its
    position, rad, about it.
    """

    name: str
    axis: Vector
    limits: tuple[float, float]
    at: Vector = (0.0, 0.0, 0.0)
    rest: float = 0.0
    turns: bool = True
    shapes: tuple[Shape, ...] = ()

    @property
    def link(self) -> str:
        """Name of the child."""
        return f'{self.name}_link'

    def transform(self, position: float) -> tuple[Vector, tuple[float, float, float, float]]:
        """Return translation, m, and quaternion x y z w of the child in the base link."""
        if not self.turns:
            x, y, z = (start + along * position
                       for start, along in zip(self.at, self.axis, strict=True))
            return (x, y, z), (0.0, 0.0, 0.0, 1.0)
        half = (self.rest + position) / 2.0
        x, y, z = (math.sin(half) * along for along in self.axis)
        return self.at, (x, y, z, math.cos(half))


@dataclass(frozen=True)
class VehicleModel:
    """Model of a world's vehicle."""

    name: str
    shapes: tuple[Shape, ...]
    joints: tuple[Joint, ...]

    def positions(self, view: RocketView) -> list[float]:
        """Return the position of each joint.

        :raises ValueError: when the state has other legs than the model.
        """
        legs = [joint for joint in self.joints if joint.turns]
        if legs and len(view.leg_angle) != len(legs):
            raise ValueError(f'leg_angle: {len(view.leg_angle)} values a sample, '
                             f'expected {len(legs)}')
        angles = iter(view.leg_angle.tolist())
        return [next(angles) if joint.turns else view.throttle for joint in self.joints]

    def urdf(self) -> str:
        """Return the model as URDF."""
        robot = ElementTree.Element('robot', name=self.name)
        _add_link(robot, BASE_LINK, self.shapes)
        for joint in self.joints:
            _add_link(robot, joint.link, joint.shapes)
            element = ElementTree.SubElement(
                robot, 'joint', name=joint.name, type='revolute' if joint.turns else 'prismatic')
            ElementTree.SubElement(element, 'parent', link=BASE_LINK)
            ElementTree.SubElement(element, 'child', link=joint.link)
            turned = tuple(joint.rest * along for along in joint.axis)
            ElementTree.SubElement(
                element, 'origin', xyz=_words(joint.at), rpy=_words(turned))
            ElementTree.SubElement(element, 'axis', xyz=_words(joint.axis))
            ElementTree.SubElement(
                element, 'limit', lower=f'{joint.limits[0]:g}', upper=f'{joint.limits[1]:g}',
                effort='0', velocity='0')
        ElementTree.indent(robot)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, 'unicode') + '\n'


def vehicle_model(info: WorldInfo) -> VehicleModel:
    """Return the model of a world's vehicle, that of `rocket` for unknown worlds."""
    if info.world == 'lunar_lander':
        return _lander()
    reach = rocket_model.FOOT_RADIUS
    if info.world == 'rocket_planar':  # seen from the side, feet at 45 deg appear at the stance
        reach = 2**0.5 * info.stance / info.scale
    return _rocket(info.world, info.scale, reach)


def _rocket(name: str, scale: float, reach: float) -> VehicleModel:
    """Return a first stage with its legs deployed; the origin is `FEET` above the ground."""
    r = rocket_model
    shapes = [
        _cylinder(r.RADIUS, -2.4, 14.0, _WHITE), _cylinder(r.RADIUS, 14.0, 19.0, _WHITE),
        _cylinder(1.01 * r.RADIUS, 19.0, 21.2, palette.SKY),
        _cylinder(r.RADIUS, 21.2, 30.5, _WHITE), _cylinder(r.RADIUS, 30.5, 36.2, _DARK),
        _cylinder(1.25, 36.2, r.NOSE, _DARK), _cylinder(1.05, r.NOZZLE_EXIT, -2.4, _STEEL)]
    for k in range(4):
        yaw = math.pi / 4 + k * math.pi / 2
        shapes += [
            _strut((1.7, -1.7), (reach - 0.4, r.FEET + 0.35), (1.3, 0.5), yaw, _DARK),
            _strut((1.8, 6.5), (reach - 0.9, r.FEET + 0.7), (0.4, 0.4), yaw, _STEEL),
            Shape((0.95, 0.4), (reach * math.cos(yaw), reach * math.sin(yaw), r.FEET + 0.2),
                  _STEEL),
            Shape((2.0, 1.5, 0.3),
                  ((r.RADIUS + 1.1) * math.cos(yaw - math.pi / 4),
                   (r.RADIUS + 1.1) * math.sin(yaw - math.pi / 4), r.FINS),
                  _STEEL, (0.0, 0.0, yaw - math.pi / 4))]
    engine = Joint(
        THROTTLE, (0.0, 0.0, -1.0), (0.0, 1.0), (0.0, 0.0, r.NOZZLE_EXIT * scale), turns=False)
    return VehicleModel(
        name, tuple(_scaled(shape, scale) for shape in shapes), (engine,))


def _lander() -> VehicleModel:
    """Return Gymnasium's lander: hull and two sprung legs, which are hinged at the origin."""
    corners = np.array(lander.HULL)
    low, high = corners.min(axis=0), corners.max(axis=0)
    hull = Shape(
        (float(high[0] - low[0]), _DEPTH, float(high[1] - low[1])),
        (0.0, 0.0, float(high[1] + low[1]) / 2), _HULL)
    legs = tuple(
        Joint(
            name, (0.0, -side, 0.0), (0.0, lander.LEG_OUTER - lander.LEG_INNER),
            rest=lander.LEG_INNER, shapes=(
                Shape((2 * lander.LEG_HALF_WIDTH, _DEPTH / 2, 2 * lander.LEG_HALF_LENGTH),
                      (side * lander.LEG_AWAY, 0.0, -lander.LEG_DOWN), _HULL),
                _strut((0.0, 0.0), (side * lander.LEG_AWAY, -lander.LEG_DOWN), (0.06, 0.06), 0.0,
                       _STEEL)))
        for name, side in (('left_leg', -1.0), ('right_leg', 1.0)))
    engine = Joint(
        THROTTLE, (0.0, 0.0, -1.0), (0.0, 1.0), (0.0, 0.0, float(low[1])), turns=False)
    return VehicleModel('lunar_lander', (hull,), (engine, *legs))


def _cylinder(radius: float, low: float, high: float, colour: Colour) -> Shape:
    return Shape((radius, high - low), (0.0, 0.0, (low + high) / 2), colour)


def _strut(
    start: tuple[float, float], end: tuple[float, float], width: tuple[float, float], yaw: float,
    colour: Colour,
) -> Shape:
    """Return a bar between points (x, z), m, turned about z by `yaw`.

    :param width: m, across and thick.
    """
    across, up = end[0] - start[0], end[1] - start[1]
    x, z = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    return Shape(
        (math.hypot(across, up), *width), (x * math.cos(yaw), x * math.sin(yaw), z), colour,
        (0.0, math.atan2(-up, across), yaw))


def _scaled(shape: Shape, scale: float) -> Shape:
    x, y, z = shape.at
    return Shape(
        tuple(length * scale for length in shape.size), (x * scale, y * scale, z * scale),
        shape.colour, shape.turned)


def _add_link(robot: ElementTree.Element, name: str, shapes: Sequence[Shape]) -> None:
    link = ElementTree.SubElement(robot, 'link', name=name)
    for number, shape in enumerate(shapes):
        visual = ElementTree.SubElement(link, 'visual')
        ElementTree.SubElement(
            visual, 'origin', xyz=_words(shape.at), rpy=_words(shape.turned))
        geometry = ElementTree.SubElement(visual, 'geometry')
        if len(shape.size) == 3:
            ElementTree.SubElement(geometry, 'box', size=_words(shape.size))
        else:
            radius, length = shape.size
            ElementTree.SubElement(
                geometry, 'cylinder', radius=f'{radius:.6g}', length=f'{length:.6g}')
        material = ElementTree.SubElement(visual, 'material', name=f'{name}_{number}')
        red, green, blue = (part / 255 for part in shape.colour)
        ElementTree.SubElement(material, 'color', rgba=_words((red, green, blue, 1.0)))


def _words(numbers: Sequence[float]) -> str:
    return ' '.join(f'{number:.6g}' for number in numbers)
