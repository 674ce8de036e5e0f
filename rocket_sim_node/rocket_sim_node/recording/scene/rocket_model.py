# SPDX-License-Identifier: Apache-2.0
"""3-D model of the rocket: a first stage on its legs, its flame and its puffs of cold gas.

Body frame, z towards the nose, metres. The origin is the world's: 5.2 m above the ground when the
rocket stands. The model has the proportions of a real first stage and does not affect the
simulation.
"""
from __future__ import annotations

import numpy as np

from rocket_sim_node.palette import Colour
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.drawing.geometry import box
from rocket_sim_node.recording.drawing.geometry import join
from rocket_sim_node.recording.drawing.geometry import revolve
from rocket_sim_node.recording.drawing.geometry import strut
from rocket_sim_node.recording.drawing.geometry import transform

FEET = -5.2
NOZZLE_EXIT = -3.6
FINS = 33.0
NOSE = 38.0
RADIUS = 1.85
FOOT_RADIUS = 9.5

_WHITE: Colour = (232, 234, 238)
_SOOT: Colour = (150, 148, 146)
_DARK: Colour = (38, 40, 46)
_STEEL: Colour = (108, 114, 124)
_BAND: Colour = (0, 114, 178)


def rocket(reach: float = FOOT_RADIUS) -> Mesh:
    """Return the vehicle with its legs deployed, about 950 triangles.

    :param reach: m, distance of the feet from the axis, at 45 deg to x.
    """
    legs = [transform(_leg(reach), yaw=np.pi / 4 + k * np.pi / 2) for k in range(4)]
    fins = [transform(_fin(), yaw=k * np.pi / 2) for k in range(4)]
    return join([_body(), _engine(), *legs, *fins])


def _body() -> Mesh:
    return revolve((
        (1.70, -2.4, _DARK), (RADIUS, -1.6, _DARK), (RADIUS, -0.2, _DARK), (RADIUS, -0.2, _SOOT),
        (RADIUS, 14.0, _WHITE), (RADIUS, 19.0, _WHITE), (RADIUS, 19.0, _BAND),
        (RADIUS, 21.2, _BAND), (RADIUS, 21.2, _WHITE), (RADIUS, 30.5, _WHITE),
        (RADIUS, 30.5, _DARK), (RADIUS, 36.2, _DARK), (1.25, 37.5, _DARK), (0.0, NOSE, _DARK),
    ))


def _engine() -> Mesh:
    nozzle = revolve((
        (1.05, NOZZLE_EXIT, _STEEL), (0.85, -3.1, _STEEL), (0.45, -2.5, _STEEL),
        (0.40, -2.2, _DARK)))
    ring = []
    for k in range(8):
        angle = k * np.pi / 4
        small = revolve(((0.42, -3.1, _STEEL), (0.18, -2.3, _DARK)), 8)
        ring.append(transform(
            small, offset=(1.25 * float(np.cos(angle)), 1.25 * float(np.sin(angle)), 0.0)))
    return join([nozzle, *ring])


def _leg(reach: float) -> Mesh:
    """Return the leg along x: a broad blade, a telescope and a foot."""
    blade = strut((1.7, 0.0, -1.7), (reach - 0.4, 0.0, FEET + 0.35), (1.9, 0.7), _DARK)
    telescope = strut((1.8, 0.0, 6.5), (reach - 0.9, 0.0, FEET + 0.7), (0.5, 0.35), _STEEL)
    foot = revolve(((0.95, FEET, _STEEL), (0.0, FEET + 0.5, _STEEL)), 12)
    return join([blade, telescope, transform(foot, offset=(reach, 0.0, 0.0))])


def _fin() -> Mesh:
    """Return the grid fin along x."""
    bars = [
        box((RADIUS + 1.1, side, FINS), (2.0, 0.14, 0.5), _STEEL) for side in (-0.75, 0.0, 0.75)]
    ends = [box((RADIUS + reach, 0.0, FINS), (0.14, 1.5, 0.5), _STEEL) for reach in (0.8, 2.0)]
    return join([*bars, *ends])


def flame() -> tuple[Mesh, Mesh]:
    """Return the flame's core and its glow, 1 m long downwards, to be stretched by thrust."""
    core = revolve((
        (0.02, -0.70, (255, 214, 130)), (0.30, -0.52, (255, 226, 150)),
        (0.55, -0.28, (255, 240, 196)), (0.66, -0.08, (255, 252, 236)),
        (0.55, 0.0, (255, 255, 255))))
    glow = revolve((
        (0.02, -1.0, (214, 66, 10)), (0.45, -0.82, (232, 88, 16)), (0.95, -0.5, (248, 126, 30)),
        (1.20, -0.2, (255, 168, 66)), (1.0, 0.0, (255, 200, 110))))
    return core, glow


def puff() -> Mesh:
    """Return a puff of cold gas along x from the body's side, to be scaled by torque."""
    cone = revolve((
        (0.1, 0.0, (245, 250, 255)), (0.7, 2.4, (226, 238, 250)), (1.3, 5.0, (190, 214, 238)),
        (1.0, 6.4, (160, 190, 226)), (0.0, 7.0, (150, 180, 220))), 12)
    return Mesh(
        cone.position[:, [2, 0, 1]] + np.array((RADIUS, 0, 0), np.float32),
        cone.normal[:, [2, 0, 1]], cone.colour, cone.triangle)
