# SPDX-License-Identifier: Apache-2.0
"""The scene where nothing flies: the vehicle stands on its pad."""
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
"""What there is to know of a vehicle that stands where nothing flies, on flat ground."""


@dataclass(frozen=True)
class _Head(Timepoint):
    """The head of one timeline and of no other: it is no step of any flight."""

    training: bool = False

    def times(self, offsets: NDArray[Any], dt: float) -> list[rr.TimeColumn]:
        """Return the time columns of rows that stand there."""
        return [
            rr.TimeColumn('iteration', sequence=[0] * len(offsets)) if self.training
            else rr.TimeColumn('sim_time', duration=np.zeros(len(offsets)))]


BEFORE_TRAINING = _Head(0, training=True)
BEFORE_FLIGHT = _Head(0)
"""What a live viewer shows until the first flight begins."""


def log_backdrop(stream: rr.RecordingStream, stage: WorldInfo, place: Timepoint) -> None:
    """Let the vehicle stand on its pad at a place of the recording."""
    values = np.zeros((1, STANDING.width))
    values[0, FIELDS['position'].stop - 1] = stage.touchdown_height
    values[0, FIELDS['orientation'].stop - 1] = 1.0
    standing = Trajectory(0, 0, 0, '', values, STANDING)
    look = scenery(stage.world)
    times = place.times(np.zeros(1), stage.dt)
    stream.send_columns(entities.ROCKET, times, rr.Transform3D.columns(
        translation=standing.position, quaternion=standing.orientation))
    log_camera(stream, standing, stage, place, look.camera)
    for effect in look.effects:
        effect(stream, standing, stage, place)
