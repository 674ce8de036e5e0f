# SPDX-License-Identifier: Apache-2.0
"""Camera of a landing: a few shots, each closer than the last.

A view of the world is `(4,)`: the point looked at and the extent of the field of view, m. Between
shots the camera does not move, so nothing is stored.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import changed
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

F64 = NDArray[np.float64]

SHOTS = (0.55, 0.28, 0.09)
"""Fractions of the initial height below which the next shot begins."""
LYING = (30.0, 60.0)
"""deg of tilt at which the view turns to a rocket that tips over, and final tilt required."""
MOVE = 0.6
"""s, duration of a transition between shots."""
FRAME = 0.04
"""s between camera updates during a transition: 25 frames a second."""


@dataclass(frozen=True)
class Camera:
    """Framing of a world.

    `frame` returns the view `(4,)` that contains pad and vehicle at a position `(3,)`; `columns`
    converts views `(k, 4)` to columns of the camera's entity. If it `follows`, it has several
    shots.
    """

    frame: Callable[[F64, WorldInfo], F64]
    columns: Callable[[F64], rr.ComponentColumnList]
    follows: bool = True


def follow(position: F64, info: WorldInfo) -> F64:
    """Return the shot that contains the pad and a rocket at `position` `(3,)`."""
    size = rocket_model.NOSE * info.scale
    extent = position[2] + 0.8 * np.hypot(position[0], position[1]) + 1.5 * size
    return np.array((
        0.5 * position[0], 0.5 * position[1], 0.5 * position[2] + 0.42 * size, extent))


def lying(flight: Trajectory, info: WorldInfo) -> F64:
    """Return the shot that contains a rocket lying where the flight ends, `(4,)`."""
    size = rocket_model.NOSE * info.scale
    middle = flight.position[-1] + 0.5 * size * flight.up[-1]
    return np.array((middle[0], middle[1], middle[2] + 0.2 * size, 1.9 * size))


def columns(views: F64) -> rr.ComponentColumnList:
    """Return the frame of a 3-D view for views `(k, 4)`; its unit length is half an extent."""
    return rr.Transform3D.columns(
        translation=views[:, :3].astype(np.float32),
        scale=np.repeat(views[:, 3:] / 2, 3, axis=1).astype(np.float32))


SPATIAL = Camera(follow, columns)


def shots(flight: Trajectory, info: WorldInfo, camera: Camera = SPATIAL) -> F64:
    """Return the view of every sample, `(n, 4)`."""
    height = flight.position[:, 2] - info.touchdown_height
    view = np.repeat(camera.frame(flight.position[0], info)[None], len(flight), axis=0)
    if not camera.follows:
        return view
    for part in SHOTS:
        below = np.flatnonzero(height <= part * height[0])
        if not below.size:
            return view
        start = int(below[0])
        _move(view, start, camera.frame(flight.position[start], info), info)
    tilt = flight.tilt
    if tilt[-1] > LYING[1]:
        falling = start + np.flatnonzero(tilt[start:] > LYING[0])
        _move(view, int(falling[0]), lying(flight, info), info)
    return view


def _move(view: F64, start: int, target: F64, info: WorldInfo) -> None:
    """Move views `(n, 4)` to `target` from row `start` on."""
    length = max(int(MOVE / info.dt), 1)
    since = np.arange(len(view)) - start
    blend = np.clip((since - since % max(int(FRAME / info.dt), 1)) / length, 0.0, 1.0)
    blend = blend * blend * (3.0 - 2.0 * blend)
    view += blend[:, None] * (target - view)


def log_camera(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
    camera: Camera,
) -> None:
    """Log the view's frame while it moves."""
    view = shots(flight, info, camera)
    rows = np.flatnonzero(changed(view))
    stream.send_columns(entities.CAMERA, at.times(rows, info.dt), camera.columns(view[rows]))
