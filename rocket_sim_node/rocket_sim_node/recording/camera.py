# SPDX-License-Identifier: Apache-2.0
"""How the 3-D view frames a landing: a few shots, each closer than the last.

The view's origin is an entity of its own whose frame is moved and scaled; a length of 1 in it is
half of what the view has to hold. Between shots nothing moves, so nothing is stored.
"""
from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording import scene
from rocket_sim_node.recording import vehicle
from rocket_sim_node.recording.place import Place
from rocket_sim_node.recording.place import changed
from rocket_sim_node.recording.samples import Flight
from rocket_sim_node.recording.stage import Stage

F64 = NDArray[np.float64]

SHOTS = (0.55, 0.28, 0.09)
"""Parts of the first height below which the next shot begins."""
MOVE = 0.6
"""s from one shot to the next"""


def frame(position: F64, stage: Stage) -> F64:
    """Return the shot that holds the pad and a rocket at `position` `(3,)`.

    :return: `(4,)`, the point looked at and the extent of the view, m.
    """
    size = vehicle.NOSE * stage.scale
    extent = position[2] + 0.8 * np.hypot(position[0], position[1]) + 1.5 * size
    return np.array((
        0.5 * position[0], 0.5 * position[1], 0.5 * position[2] + 0.42 * size, extent))


def shots(flight: Flight, stage: Stage) -> F64:
    """Return the view of every sample, `(n, 4)` as in :func:`frame`."""
    height = flight.position[:, 2] - stage.touchdown_height
    view = np.repeat(frame(flight.position[0], stage)[None], len(flight), axis=0)
    length = max(int(MOVE / stage.dt), 1)
    for part in SHOTS:
        below = np.flatnonzero(height <= part * height[0])
        if not below.size:
            break
        start = int(below[0])
        blend = np.clip((np.arange(len(flight)) - start) / length, 0.0, 1.0)
        blend = blend * blend * (3.0 - 2.0 * blend)
        view += blend[:, None] * (frame(flight.position[start], stage) - view)
    return view


def log_camera(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Log the view's frame where it moves."""
    view = shots(flight, stage)
    rows = np.flatnonzero(changed(view))
    stream.send_columns(scene.CAMERA, place.times(rows, stage.dt), rr.Transform3D.columns(
        translation=view[rows, :3].astype(np.float32),
        scale=np.repeat(view[rows, 3:] / 2, 3, axis=1).astype(np.float32)))
