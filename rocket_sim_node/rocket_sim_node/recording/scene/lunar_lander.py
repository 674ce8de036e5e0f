# SPDX-License-Identifier: Apache-2.0
"""Appearance of world `lunar_lander`: hull, two sprung legs, flags and each episode's ground."""
from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node.palette import Colour
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import planar_view
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.drawing.geometry import join
from rocket_sim_node.recording.drawing.geometry import revolve
from rocket_sim_node.recording.drawing.planar_view import polygon
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import changed
from rocket_sim_node.recording.scene import contact_log
from rocket_sim_node.recording.scene import effects
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.worlds.lunar import vehicle

F64 = NDArray[np.float64]

ASPECT = 1.5
"""Aspect ratio of the field: 20 m wide, 13.3 m high; the pad is at a quarter of its height."""
LABEL = 1.3 / vehicle.LEG_DOWN
"""Height of the outcome's label above the hull's origin, in standing heights of that."""
VELOCITY = 0.4 / vehicle.LEG_DOWN
"""Length of the arrow for 1 m/s, in the same unit."""
FLAME = (0.8, 2.0, 9.0)
"""Width, length when on and additional length at full throttle, relative to the rocket's flame."""
IN_FRONT = 0.3
"""m, distance of arrows in front of the vehicle."""
TURN = 0.04
"""rad of a leg's angle below which a change is not stored."""
_HULL: Colour = (142, 120, 226)
_EDGE: Colour = (84, 70, 150)
_LEG: Colour = (170, 156, 232)
_NOZZLE: Colour = (108, 114, 124)
_WINDOW: Colour = (196, 226, 255)
_MOON: Colour = (112, 116, 126)
_RIM: Colour = (226, 230, 236)


def frame(position: F64, info: WorldInfo) -> F64:
    """Return the view of the whole field, wherever the lander is."""
    height = 2.0 * info.field_half_width / ASPECT
    return np.array((0.0, 0.0, 0.25 * height, height))


def log_static(stream: rr.RecordingStream, info: WorldInfo) -> None:
    """Log flags and vehicle, and the style of the ground."""
    planar_view.log_eye(stream)
    entities.log_styles(stream, info, unit=0.05, mark=0.11, in_front=IN_FRONT)
    planar_view.log_terrain_style(stream, _MOON, _RIM)
    stream.log(entities.GROUND, entities.archetype(join(_flags(info)), shaded=False), static=True)
    stream.log(entities.BODY, entities.archetype(hull(), shaded=False), static=True)
    for entity, side in zip(entities.LEGS, (-1.0, 1.0), strict=True):
        stream.log(f'{entity}/strut', entities.archetype(leg(side), shaded=False), static=True)
    effects.log_flame_shape(stream, -13.0 / 30.0)
    effects.log_puff_shape(stream, _puff(), 0.25, opacity=170)
    contact_log.log_style(stream, info)


def hull() -> Mesh:
    """Return the world's hull, with an edge, a window and a nozzle added."""
    corners = np.array(vehicle.HULL)
    inner = corners * 0.86 + (0.0, 0.015)
    pixel = 1.0 / 30.0
    nozzle = np.array(((-5, -10), (5, -10), (8, -14), (-8, -14))) * pixel
    window = np.array(((-7, 4), (7, 4), (5, 12), (-5, 12))) * pixel
    return join([
        polygon(nozzle, _NOZZLE, 0.10), polygon(corners, _EDGE, 0.06), polygon(inner, _HULL, 0.03),
        polygon(window, _WINDOW, 0.0)])


def leg(side: float) -> Mesh:
    """Return a leg in its unrotated position relative to the hull's origin.

    :param side: -1 left, 1 right.
    """
    def box(grow: float, colour: Colour, behind: float) -> Mesh:
        width = vehicle.LEG_HALF_WIDTH + grow
        length = vehicle.LEG_HALF_LENGTH + grow
        x, z = side * vehicle.LEG_AWAY, -vehicle.LEG_DOWN
        return polygon([
            (x - width, z - length), (x + width, z - length),
            (x + width, z + length), (x - width, z + length)], colour, behind)

    # In the world only a hinge holds the leg; the drawing adds a strut from there.
    centre = np.array((side * vehicle.LEG_AWAY, -vehicle.LEG_DOWN))
    across = 0.035 * np.array((centre[1], -centre[0])) / np.linalg.norm(centre)
    strut = polygon(
        np.array((across, centre + across, centre - across, -across)), _NOZZLE, 0.2)
    return join([strut, box(0.0, _EDGE, 0.16), box(-0.02, _LEG, 0.13)])


def _puff() -> Mesh:
    """Return the gas of the right side engine, from the hull outwards."""
    cone = revolve((
        (0.04, 0.0, (255, 226, 150)), (0.10, 0.25, (255, 196, 110)), (0.17, 0.6, (248, 146, 60)),
        (0.0, 0.95, (232, 100, 30))), 12)
    return Mesh(
        cone.position[:, [2, 0, 1]] + np.array((0.55, 0, 0), np.float32),
        cone.normal[:, [2, 0, 1]], cone.colour, cone.triangle)


def _flags(info: WorldInfo) -> list[Mesh]:
    """Return the flags at the ends of the pad and the strip between them."""
    limit = info.landed_distance
    parts = [polygon(
        [(-limit, -0.12), (limit, -0.12), (limit, 0.0), (-limit, 0.0)], palette.TARGET, 0.3)]
    for x in (-limit, limit):
        parts += [
            polygon([(x - 0.03, 0.0), (x + 0.03, 0.0), (x + 0.03, 1.67), (x - 0.03, 1.67)],
                    palette.PAINT, 0.25),
            polygon([(x, 1.67), (x, 1.33), (x + 0.83, 1.5)], palette.TARGET, 0.22)]
    return parts


def turned(flight: Trajectory) -> F64:
    """Return the legs' outward rotation about the hull's origin, `(n, 2)` rad."""
    return np.asarray(vehicle.LEG_INNER + flight.leg_angle)


def feet(flight: Trajectory) -> F64:
    """Return the positions of the legs' ends in the world, `(n, 2, 3)`, left and right."""
    end = vehicle.LEG_DOWN + vehicle.LEG_HALF_LENGTH
    ends = []
    for side, angle in zip((-1.0, 1.0), turned(flight).T, strict=True):
        straight = np.tile((side * vehicle.LEG_AWAY, 0.0, -end), (len(flight), 1))
        in_hull = frames.to_world(planar_view.turn(side * angle), straight)
        ends.append(flight.position + frames.to_world(flight.orientation, in_hull))
    return np.stack(ends, axis=1)


def log_legs(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Log the legs' rotation."""
    angles = vehicle.LEG_INNER + np.round(flight.leg_angle / TURN) * TURN
    for entity, side, angle in zip(entities.LEGS, (-1.0, 1.0), angles.T, strict=True):
        rows = np.flatnonzero(changed(angle[:, None]))
        stream.send_columns(entity, at.times(rows, info.dt), rr.Transform3D.columns(
            quaternion=planar_view.turn(side * angle[rows]).astype(np.float32)))


def log_flame(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Scale the flame by the throttle."""
    width, *length = FLAME
    effects.stretch_flame(stream, flight, info, at, width, (length[0], length[1]))


def log_side_engines(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Log the side engines' gas, opposite to their push."""
    rows = effects.every(effects.EFFECT_STEP, len(flight))
    side = -np.sign(flight.lateral_thrust[rows])
    side[-1] = 0.0
    keep = changed(side[:, None])
    size = np.where(side[keep] == 0.0, 1e-3, 1.0)
    stream.send_columns(entities.PUFF, at.times(rows[keep], info.dt), rr.Transform3D.columns(
        quaternion=planar_view.turn(np.where(side[keep] < 0.0, np.pi, 0.0)).astype(np.float32),
        scale=np.repeat(size[:, None], 3, axis=1).astype(np.float32)))


def log_contact(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Highlight parts in contact."""
    contact_log.log_contact(stream, flight, info, at, feet(flight), IN_FRONT)
