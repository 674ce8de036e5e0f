# SPDX-License-Identifier: Apache-2.0
"""Logging of ground contact: feet that touch, and the contact force."""
from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.plots import weights
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import changed
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

F64 = NDArray[np.float64]

ARROW = 2.0
"""Length of the arrow for a force of one weight, in standing heights of the vehicle's origin."""
STRONGEST = 2.5
"""Weights; the arrow is not longer for a stronger force."""
GRAIN = 0.1
"""Fraction of that height below which a change is not stored."""


def log_style(stream: rr.RecordingStream, info: WorldInfo) -> None:
    """Log the style of contacts."""
    unit = info.unit
    stream.log(entities.CONTACT, rr.Points3D.from_fields(
        radii=0.15 * unit, colors=[palette.TARGET]), rr.Arrows3D.from_fields(
        radii=[0.05 * unit], colors=[palette.VERMILION]), static=True)


def log_contact(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
    feet: F64 | None = None, in_front: float = 0.0,
) -> None:
    """Highlight the feet that touch, and draw the contact force; nothing while in flight.

    :param feet: `(n, L, 3)` in the world, in the order of `flight.contact`, if their positions
        are known. The force begins between those that touch, otherwise at the vehicle's origin.
    :param in_front: m, distance of all that is drawn in front of the vehicle, as seen along y.
    """
    unit = info.unit
    force = weights(flight, info)
    strength = np.linalg.norm(force, axis=1, keepdims=True)
    force *= np.minimum(1.0, STRONGEST / np.maximum(strength, 1e-9))
    if feet is None:
        feet = np.zeros((len(flight), 0, 3))
    touching = flight.contact[:, :feet.shape[1]] > 0.0
    lit = np.where(touching[:, :, None], feet, 0.0)
    count = touching.sum(axis=1)
    start = np.where(
        count[:, None] > 0, lit.sum(axis=1) / np.maximum(count, 1)[:, None], flight.position)
    pushed = strength[:, 0] > 0.0
    shown = np.concatenate((
        touching, (pushed | (count > 0))[:, None]
        * np.round(np.column_stack((start, ARROW * unit * force)) / (GRAIN * unit))), axis=1)
    if not shown.any():
        return
    lit[:, :, 1] -= in_front
    start[:, 1] -= in_front
    rows = np.flatnonzero(changed(shown) & (np.cumsum(shown.any(axis=1)) > 0))
    arrows = rows[pushed[rows]]
    # The final contact is shown as long as the vehicle, and a last row clears it.
    last = len(flight) + pause_steps(info) - 1
    stream.send_columns(entities.CONTACT, at.times(np.append(rows, last), info.dt), [
        *rr.Points3D.columns(positions=lit[rows][touching[rows]].astype(np.float32)).partition(
            np.append(count[rows], 0)),
        *rr.Arrows3D.columns(
            vectors=(ARROW * unit * force[arrows]).astype(np.float32),
            origins=start[arrows].astype(np.float32),
        ).partition(np.append(pushed[rows].astype(np.int64), 0)),
    ])
