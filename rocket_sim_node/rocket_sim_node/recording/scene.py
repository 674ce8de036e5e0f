# SPDX-License-Identifier: Apache-2.0
"""What stands still: ground, pad and vehicle, logged once at the head of a recording."""
from __future__ import annotations

import numpy as np
import rerun as rr

from rocket_sim_node.recording import palette
from rocket_sim_node.recording import vehicle
from rocket_sim_node.recording.geometry import Mesh
from rocket_sim_node.recording.geometry import join
from rocket_sim_node.recording.geometry import ring
from rocket_sim_node.recording.geometry import transform
from rocket_sim_node.recording.palette import Colour
from rocket_sim_node.recording.stage import Stage

WORLD = '/world'
ROCKET = '/world/rocket'
ENGINE = '/world/rocket/engine'
FLAME = '/world/rocket/engine/flame'
THRUSTERS = '/world/rocket/thrusters'
PUFF = '/world/rocket/thrusters/puff'
TRAIL = '/world/trail'
PATHS = '/world/paths'
LANDINGS = '/world/landings'
CAMERA = '/camera'
PHASE = '/world/phase'
LOG = '/log'
TRAINING = '/training'
TRAINING_STAGE = '/training/stage'

_GROUND: Colour = (50, 58, 66)
_CONCRETE: Colour = (92, 98, 106)
_LIP: Colour = (70, 76, 84)
_LINE: Colour = (84, 94, 106)
_PAINT: Colour = (240, 242, 246)
_TARGET: Colour = (255, 206, 84)
_VELOCITY: Colour = palette.SKY
_THRUST: Colour = palette.ORANGE


def log_static(stream: rr.RecordingStream, stage: Stage) -> None:
    """Log all that does not move, and the styles of what will."""
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log(
        f'{WORLD}/ground', archetype(join([_ground(stage), _pad(stage)]), shaded=False),
        static=True)
    stream.log(f'{WORLD}/rings', _rings(stage), static=True)
    stream.log(
        f'{ROCKET}/body', archetype(transform(vehicle.rocket(), stage.scale)), static=True)
    for entity, height in ((ENGINE, vehicle.NOZZLE_EXIT), (THRUSTERS, vehicle.FINS + 2.2)):
        stream.log(entity, rr.Transform3D(translation=(0, 0, height * stage.scale)), static=True)
    core, glow = vehicle.flame()
    stream.log(f'{FLAME}/core', archetype(core, shaded=False), static=True)
    stream.log(f'{FLAME}/glow', archetype(glow, shaded=False, opacity=120), static=True)
    stream.log(f'{PUFF}/gas', archetype(vehicle.puff(), shaded=False, opacity=150), static=True)
    stream.log(
        ROCKET, rr.Arrows3D.from_fields(
            colors=[_VELOCITY, _THRUST], radii=[0.35 * stage.scale],
            origins=[(0, 0, 0), (0, 0, vehicle.NOSE * stage.scale)]), static=True)
    stream.log(
        TRAIL, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.5)), static=True)
    stream.log(
        PATHS, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.2)), static=True)
    stream.log(LANDINGS, rr.Points3D.from_fields(radii=0.8), static=True)
    names = [*palette.PHASES, *stage.outcomes]
    colours = {**palette.PHASES, **palette.outcome_colours(stage.outcomes)}
    stream.log(PHASE, rr.StateConfiguration(
        values=names, labels=[name.replace('_', ' ') for name in names],
        colors=[colours[name] for name in names]),
        rr.Points3D.from_fields(radii=0.01), static=True)


def archetype(mesh: Mesh, shaded: bool = True, opacity: int = 255) -> rr.Mesh3D:
    """Return a mesh as Rerun takes it; without normals it is drawn in its own light."""
    return rr.Mesh3D(
        vertex_positions=mesh.position, triangle_indices=mesh.triangle,
        vertex_normals=mesh.normal if shaded else None, vertex_colors=mesh.colour,
        albedo_factor=(255, 255, 255, opacity) if opacity < 255 else None)


def _ground(stage: Stage) -> Mesh:
    """Return the ground, fading into the background at the horizon."""
    near, far = 1.2 * stage.range_limit, 5.0 * stage.range_limit
    return join([
        ring(0.0, near, -0.6, (_GROUND, (34, 41, 50))),
        ring(near, far, -0.6, ((34, 41, 50), palette.BACKGROUND))])


def _pad(stage: Stage) -> Mesh:
    """Return the pad: concrete, the circle within which a landing counts, and its centre."""
    limit = stage.landed_distance
    edge = 1.6 * limit
    paint = [
        ring(0.0, edge, -0.30, (_CONCRETE, _CONCRETE)),
        ring(edge, edge * 1.03, -0.30, (_LIP, _LIP)),
        ring(limit - 0.5, limit + 0.5, 0.0, (_TARGET, _TARGET)),
        ring(limit / 2 - 0.3, limit / 2 + 0.3, 0.0, (_PAINT, _PAINT)),
        ring(0.0, 0.9, 0.05, (_PAINT, _PAINT)),
    ]
    for k in range(4):
        corners = np.array([
            (limit * 0.62, -0.35, 0.0), (limit * 0.95, -0.35, 0.0),
            (limit * 0.95, 0.35, 0.0), (limit * 0.62, 0.35, 0.0)], np.float32)
        stripe = Mesh(
            corners, np.tile(np.array((0, 0, 1), np.float32), (4, 1)),
            np.repeat(np.array([_PAINT], np.uint8), 4, axis=0),
            np.array(((0, 1, 2), (0, 2, 3)), np.uint32))
        paint.append(transform(stripe, yaw=k * np.pi / 2))
    return join(paint)


def _rings(stage: Stage) -> rr.LineStrips3D:
    """Return rings of equal distance on the ground, every 50 m, and the axes."""
    angle = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack((np.cos(angle), np.sin(angle), np.full(73, 0.0)), axis=1)
    radii = np.arange(50.0, stage.range_limit + 1.0, 50.0)
    strips = [circle * (r, r, 1.0) - (0.0, 0.0, 0.4) for r in radii]
    reach = float(radii[-1]) if len(radii) else stage.range_limit
    start = 1.7 * stage.landed_distance
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        strips.append(np.array(((x * start, y * start, -0.4), (x * reach, y * reach, -0.4))))
    return rr.LineStrips3D(
        [strip.astype(np.float32) for strip in strips], colors=[_LINE],
        radii=rr.Radius.ui_points(0.8))
