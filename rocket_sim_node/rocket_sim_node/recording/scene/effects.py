# SPDX-License-Identifier: Apache-2.0
"""Logging of the rocket's flame and cold gas during a flight."""
from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.frames import to_body
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import changed
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

FLAME_LENGTH = (5.0, 20.0)
"""m of flame when the engine is on, and additional m at full throttle."""
FLAME_WIDTH = 1.5
EFFECT_STEP = 5
"""Flame and puffs are logged at this interval, in steps."""


def log_body(stream: rr.RecordingStream, scale: float) -> None:
    """Log origins and shapes of flame and gas."""
    log_flame_shape(stream, rocket_model.NOZZLE_EXIT * scale)
    log_puff_shape(stream, rocket_model.puff(), (rocket_model.FINS + 2.2) * scale, opacity=150)


def log_flame_shape(stream: rr.RecordingStream, height: float) -> None:
    """Log the flame, 1 m long, which begins at a height in the body frame."""
    core, glow = rocket_model.flame()
    stream.log(
        entities.FLAME, _at(height), entities.archetype(core, shaded=False), static=True)
    stream.log(
        f'{entities.FLAME}/glow', entities.archetype(glow, shaded=False, opacity=120), static=True)


def log_puff_shape(stream: rr.RecordingStream, mesh: Mesh, height: float, opacity: int) -> None:
    """Log the gas of a thruster, which begins at a height in the body frame."""
    stream.log(
        entities.PUFF, _at(height), entities.archetype(mesh, shaded=False, opacity=opacity),
        static=True)


def _at(height: float) -> rr.Transform3D:
    """Return the transform of an effect's origin; the flight sets its size and attitude."""
    return rr.Transform3D.from_fields(translation=(0.0, 0.0, height))


def every(step: int, n: int) -> NDArray[np.int64]:
    """Return every `step`-th of n rows, and the last."""
    return np.unique(np.append(np.arange(0, n, step), n - 1))


def log_flame(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Scale the flame by the throttle."""
    stretch_flame(stream, flight, info, at, FLAME_WIDTH, FLAME_LENGTH)


def stretch_flame(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
    width: float,
    length: tuple[float, float],
) -> None:
    """Log a flame's size; it flickers slightly, and vanishes at the end.

    :param width: relative to that of the shape.
    :param length: m when the engine is on, and additional m at full throttle.
    """
    rows = every(EFFECT_STEP, len(flight))
    throttle = np.append(flight.throttle[rows[:-1]], 0.0)
    flicker = 1.0 + 0.06 * np.where(np.arange(len(rows)) % 2, 1.0, -1.0)
    scale = np.full((len(rows), 3), width)
    scale[:, 2] = (length[0] + length[1] * throttle) * flicker
    scale[throttle <= 0.0] = 1e-3
    keep = changed(scale)
    stream.send_columns(
        entities.FLAME, at.times(rows[keep], info.dt),
        rr.Transform3D.columns(scale=(scale[keep] * info.scale).astype(np.float32)))


def log_puffs(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Log gas at the top of the body, opposite to the force of the torque."""
    rows = every(EFFECT_STEP, len(flight))
    torque = flight.torque[rows] / info.max_torque
    push = np.cross(torque, flight.up[rows])
    gas = -to_body(flight.orientation[rows], push)
    strength = np.minimum(np.hypot(gas[:, 0], gas[:, 1]), 1.0)
    strength[-1] = 0.0
    # Steps of a tenth: smaller changes are invisible and need not be stored.
    strength = np.round(strength, 1)
    angle = np.where(strength > 0.0, np.round(np.arctan2(gas[:, 1], gas[:, 0]), 1), 0.0)
    keep = changed(np.stack((strength, angle), axis=1))
    half = angle[keep] / 2
    quaternion = np.stack((0 * half, 0 * half, np.sin(half), np.cos(half)), axis=1)
    size = np.where(strength[keep] > 0, 0.3 + 0.7 * strength[keep], 1e-3) * info.scale
    stream.send_columns(
        entities.PUFF, at.times(rows[keep], info.dt), rr.Transform3D.columns(
            quaternion=quaternion.astype(np.float32),
            scale=np.repeat(size[:, None], 3, axis=1).astype(np.float32)))
