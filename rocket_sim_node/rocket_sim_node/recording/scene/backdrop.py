# SPDX-License-Identifier: Apache-2.0
"""Scene without a flight: the vehicle stands on its pad."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.scene.camera import log_camera
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Layout

STANDING = Layout(legs=2)
"""Layout of a sample of a vehicle standing on flat ground."""


@dataclass(frozen=True)
class _Head(Timepoint):
    """The start of a single timeline, which is not a step of any flight."""

    training: bool = False

    def times(self, offsets: NDArray[Any], dt: float) -> list[rr.TimeColumn]:
        """Return the time columns of rows at that position."""
        return [
            rr.TimeColumn('iteration', sequence=[0] * len(offsets)) if self.training
            else rr.TimeColumn('sim_time', duration=np.zeros(len(offsets)))]


BEFORE_TRAINING = _Head(0, training=True)
BEFORE_FLIGHT = _Head(0)
"""Position of the scene that a live viewer shows until the first flight begins."""


def log_backdrop(stream: rr.RecordingStream, info: WorldInfo, at: Timepoint) -> None:
    """Log the vehicle standing on its pad at a position of the recording."""
    values = np.zeros((1, STANDING.width))
    values[0, FIELDS['position'].stop - 1] = info.touchdown_height
    values[0, FIELDS['orientation'].stop - 1] = 1.0
    standing = Trajectory(0, 0, 0, '', values, STANDING)
    look = scenery(info.world)
    times = at.times(np.zeros(1), info.dt)
    stream.send_columns(entities.ROCKET, times, rr.Transform3D.columns(
        translation=standing.position, quaternion=standing.orientation))
    log_camera(stream, standing, info, at, look.camera)
    for effect in look.effects:
        effect(stream, standing, info, at)
