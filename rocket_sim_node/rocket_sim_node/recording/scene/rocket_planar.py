# SPDX-License-Identifier: Apache-2.0
"""Appearance of world `rocket_planar`: the rocket from its side, above a plain with a pad."""
from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import planar_view
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.drawing.geometry import join
from rocket_sim_node.recording.drawing.geometry import transform
from rocket_sim_node.recording.drawing.planar_view import polygon
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.scene import contact_log
from rocket_sim_node.recording.scene import effects
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

DEPTH = 3.0
"""m of concrete below the pad."""
MARK = 50.0
"""m between the distance marks in the ground."""
IN_FRONT = 8.0
"""m, distance of arrows in front of the vehicle, which has a radius."""


def log_static(stream: rr.RecordingStream, info: WorldInfo) -> None:
    """Log ground, pad and vehicle."""
    planar_view.log_eye(stream)
    entities.log_styles(
        stream, info, unit=0.35 * info.scale, mark=0.8, in_front=IN_FRONT * info.scale)
    ground = entities.archetype(join(_ground(info)), shaded=False)
    stream.log(entities.GROUND, ground, static=True)
    # Seen from the side, feet at 45 deg appear at the stance.
    body = rocket_model.rocket(2**0.5 * info.stance / info.scale)
    stream.log(entities.BODY, entities.archetype(transform(body, info.scale)), static=True)
    effects.log_body(stream, info.scale)
    contact_log.log_style(stream, info)


def _bar(x: tuple[float, float], z: tuple[float, float], colour: palette.Colour,
         behind: float) -> Mesh:
    return polygon([(x[0], z[0]), (x[1], z[0]), (x[1], z[1]), (x[0], z[1])], colour, behind)


def _ground(info: WorldInfo) -> list[Mesh]:
    """Return the plain with distance marks, and the pad within which a landing counts."""
    far, limit = 20.0 * info.range_limit, info.landed_distance
    parts = [
        _bar((-far, far), (-far, 0.0), palette.SOIL, 14.0),
        _bar((-far, far), (-0.6, 0.0), palette.CONCRETE, 13.5),
        _bar((-limit, limit), (-DEPTH, 0.0), palette.CONCRETE, 13.0),
        _bar((-limit, limit), (-0.8, 0.0), palette.TARGET, 12.5),
        _bar((-0.5, 0.5), (-DEPTH, 0.0), palette.PAINT, 12.0),
    ]
    for side in (-limit, limit):
        parts.append(_bar((side - 0.4, side + 0.4), (-DEPTH, 2.0), palette.TARGET, 12.0))
    for x in np.arange(MARK, info.range_limit + 1.0, MARK).tolist():
        parts += [
            _bar((side * x - 0.4, side * x + 0.4), (-2.0, 0.0), palette.CONCRETE, 12.0)
            for side in (-1, 1)]
    return parts


def feet(flight: Trajectory, info: WorldInfo) -> NDArray[np.float64]:
    """Return the positions of the feet in the world, `(n, 2, 3)`, left and right."""
    return np.stack([
        flight.position + frames.to_world(flight.orientation, np.tile(
            (side * info.stance, 0.0, -info.touchdown_height), (len(flight), 1)))
        for side in (-1.0, 1.0)], axis=1)


def log_contact(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Highlight parts in contact."""
    if flight.layout.legs == 2:
        contact_log.log_contact(
            stream, flight, info, at, feet(flight, info), IN_FRONT * info.scale)
