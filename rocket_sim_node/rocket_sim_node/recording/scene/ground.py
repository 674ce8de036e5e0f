# SPDX-License-Identifier: Apache-2.0
"""Ground of 3-D worlds: a plain, the pad, and rings of equal distance."""
from __future__ import annotations

import numpy as np
import rerun as rr

from rocket_sim_node import palette
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.drawing.geometry import join
from rocket_sim_node.recording.drawing.geometry import ring
from rocket_sim_node.recording.drawing.geometry import transform
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

_LIP: palette.Colour = (70, 76, 84)
_LINE: palette.Colour = (84, 94, 106)


def log_ground(stream: rr.RecordingStream, info: WorldInfo) -> None:
    """Log ground, pad and rings."""
    stream.log(entities.GROUND, entities.archetype(
        join([_ground(info), _pad(info)]), shaded=False), static=True)
    stream.log(f'{entities.WORLD}/rings', _rings(info), static=True)


def _ground(info: WorldInfo) -> Mesh:
    """Return the ground, fading into the background at the horizon."""
    near, far = 1.2 * info.range_limit, 5.0 * info.range_limit
    return join([
        ring(0.0, near, -0.6, (palette.SOIL, (34, 41, 50))),
        ring(near, far, -0.6, ((34, 41, 50), palette.BACKGROUND))])


def _pad(info: WorldInfo) -> Mesh:
    """Return the pad: concrete, the circle within which a landing counts, and its centre."""
    limit = info.landed_distance
    edge = 1.6 * limit
    paint = [
        ring(0.0, edge, -0.30, (palette.CONCRETE, palette.CONCRETE)),
        ring(edge, edge * 1.03, -0.30, (_LIP, _LIP)),
        ring(limit - 0.5, limit + 0.5, 0.0, (palette.TARGET, palette.TARGET)),
        ring(limit / 2 - 0.3, limit / 2 + 0.3, 0.0, (palette.PAINT, palette.PAINT), 32),
        ring(0.0, 0.9, 0.05, (palette.PAINT, palette.PAINT), 16),
    ]
    for k in range(4):
        corners = np.array([
            (limit * 0.62, -0.35, 0.0), (limit * 0.95, -0.35, 0.0),
            (limit * 0.95, 0.35, 0.0), (limit * 0.62, 0.35, 0.0)], np.float32)
        stripe = Mesh(
            corners, np.tile(np.array((0, 0, 1), np.float32), (4, 1)),
            np.repeat(np.array([palette.PAINT], np.uint8), 4, axis=0),
            np.array(((0, 1, 2), (0, 2, 3)), np.uint32))
        paint.append(transform(stripe, yaw=k * np.pi / 2))
    return join(paint)


def _rings(info: WorldInfo) -> rr.LineStrips3D:
    """Return rings of equal distance on the ground, every 50 m, and the axes."""
    angle = np.linspace(0, 2 * np.pi, 61)
    circle = np.stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)), axis=1)
    radii = np.arange(50.0, info.range_limit + 1.0, 50.0)
    strips = [circle * (r, r, 1.0) - (0.0, 0.0, 0.4) for r in radii]
    reach = float(radii[-1]) if len(radii) else info.range_limit
    start = 1.7 * info.landed_distance
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        strips.append(np.array(((x * start, y * start, -0.4), (x * reach, y * reach, -0.4))))
    return rr.LineStrips3D(
        [strip.astype(np.float32) for strip in strips], colors=[_LINE],
        radii=rr.Radius.ui_points(0.8))
