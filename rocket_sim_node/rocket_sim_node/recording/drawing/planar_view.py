# SPDX-License-Identifier: Apache-2.0
"""2-D view of a planar world from its side, x to the right and z up.

Only this module converts between the picture's y, which points down, and the world's z, which
points up: by a pinhole camera in front of the plane, whose axes are declared as right, forward,
up. The world is drawn with 3-D shapes, filled and batched as elsewhere, and projected by the
camera. The camera is so far away that there is no visible perspective.
"""
from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.palette import Colour
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.views import histories
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

F64 = NDArray[np.float64]
Corners = F64 | list[tuple[float, float]]

PICTURE = 1000.0
"""Height of the picture in the view's units."""
DISTANCE = 8.0
"""Distance of the camera from the plane, in heights of its field of view."""


def view(aspect: float = 1.0) -> rrb.Spatial2DView:
    """Return the 2-D view; it shows at least a picture `aspect` times as wide as high."""
    half = PICTURE / 2
    return rrb.Spatial2DView(
        name='Landing', origin=entities.CAMERA,
        contents=[f'+ {entities.WORLD}/**', f'+ {entities.CAMERA}'],
        background=list(palette.BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-half * aspect, half * aspect), y_range=(-half, half)),
        overrides=histories())


def log_eye(stream: rr.RecordingStream) -> None:
    """Log the camera's intrinsics, by which one extent of the world fills the picture's height."""
    stream.log(entities.CAMERA, rr.Pinhole(
        focal_length=PICTURE * DISTANCE, width=PICTURE, height=PICTURE, principal_point=(0, 0),
        camera_xyz=rr.ViewCoordinates.RFU), static=True)


def columns(views: F64) -> rr.ComponentColumnList:
    """Return the camera poses for views `(k, 4)`: the point looked at and the extent."""
    return rr.Transform3D.columns(translation=np.column_stack((
        views[:, 0], -DISTANCE * views[:, 3], views[:, 2])).astype(np.float32))


def turn(angle: F64) -> F64:
    """Return quaternions `(k, 4)` that turn by `angle` `(k,)` rad, counter-clockwise as seen."""
    zero = np.zeros_like(angle)
    return np.stack((zero, -np.sin(angle / 2), zero, np.cos(angle / 2)), axis=1)


def polygon(corners: Corners, colour: Colour, behind: float = 0.0) -> Mesh:
    """Return a filled convex polygon in the plane.

    :param corners: `(k, 2)` x and z, in order.
    :param behind: m, distance behind the plane.
    """
    flat = np.asarray(corners, np.float64)
    k = len(flat)
    position = np.column_stack((flat[:, 0], np.full(k, behind), flat[:, 1]))
    fan = np.column_stack((np.zeros(k - 2), np.arange(1, k - 1), np.arange(2, k)))
    return Mesh(
        position.astype(np.float32), np.tile(np.array((0, -1, 0), np.float32), (k, 1)),
        np.tile(np.array(colour, np.uint8), (k, 1)), fan.astype(np.uint32))


def log_terrain(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Log the ground of a flight as a filled strip with an edge; outside it continues level."""
    half = info.field_half_width
    height = flight.terrain[0] if flight.layout.heights else np.zeros(2)
    x = np.linspace(-half, half, len(height))
    x = np.concatenate(([-10 * half], x, [10 * half]))
    z = height[np.clip(np.arange(-1, len(height) + 1), 0, len(height) - 1)]
    k = len(x)
    behind = np.full(k, 0.05 * half)
    top = np.column_stack((x, behind, z))
    bottom = np.column_stack((x, behind, np.full(k, -10 * half)))
    left = np.arange(k - 1)
    triangles = np.concatenate((
        np.column_stack((left, left + k, left + 1)),
        np.column_stack((left + 1, left + k, left + k + 1))))
    first = at.times(np.array([0]), info.dt)
    stream.send_columns(entities.TERRAIN, first, [
        *rr.Mesh3D.columns(
            vertex_positions=np.concatenate((top, bottom)).astype(np.float32)
        ).partition([2 * k]),
        *rr.Mesh3D.columns(
            triangle_indices=triangles.astype(np.uint32)).partition([len(triangles)]),
    ])
    stream.send_columns(entities.SURFACE, first, rr.LineStrips3D.columns(
        strips=[(top - (0.0, 0.01 * half, 0.0)).astype(np.float32)]))


def log_terrain_style(stream: rr.RecordingStream, colour: Colour, edge: Colour) -> None:
    """Log the style of the ground."""
    stream.log(entities.TERRAIN, rr.Mesh3D.from_fields(albedo_factor=colour), static=True)
    stream.log(entities.SURFACE, rr.LineStrips3D.from_fields(
        radii=rr.Radius.ui_points(1.2), colors=[edge]), static=True)
