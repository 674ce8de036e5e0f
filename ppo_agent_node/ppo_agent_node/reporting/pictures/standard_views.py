# SPDX-License-Identifier: Apache-2.0
"""A flight as RViz and Foxglove show it: the markers and the model of node `ros_bridge`."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.standard_views.markers import Ends
from rocket_sim_node.standard_views.markers import Marker
from rocket_sim_node.standard_views.markers import RocketMarkers
from rocket_sim_node.standard_views.markers import Shape
from rocket_sim_node.standard_views.markers import scene
from rocket_sim_node.standard_views.motion import RocketView
from rocket_sim_node.standard_views.vehicle_model import Shape as Part
from rocket_sim_node.standard_views.vehicle_model import vehicle_model

F64 = NDArray[np.float64]

_SIDES = 24
_GROUND, _LINES, _VEHICLE, _FRONT = range(4)
"""Order of drawing, as the parts are too large to be sorted by their distance."""
_INK = '#10141e'


def views_figure(views: Sequence[RocketView], info: WorldInfo) -> Figure:
    """Return a figure of two moments of a flight: in its burn, and at its end.

    :param views: of one rocket, one episode, in order.
    """
    markers, ends = RocketMarkers(info), Ends()
    burning = max(
        (k for k, view in enumerate(views) if view.throttle > 0.0 and view.position[2] > 25.0),
        default=len(views) // 2)
    for view in views[:burning + 1]:
        markers.add(view)
    figure = Figure(figsize=(12.0, 6.4), facecolor=_INK)
    overview = figure.add_subplot(1, 2, 1, projection='3d')
    _draw(overview, [*scene(info, ends), *markers.of(views[burning])], views[burning], info)
    _frame(overview, np.array((0.0, 0.0, 55.0)), 75.0, 'rocket_0 during its burn')
    for view in views[burning + 1:]:
        markers.add(view)
    ends.add(views[-1])
    near = figure.add_subplot(1, 2, 2, projection='3d')
    _draw(near, [*scene(info, ends), *markers.of(views[-1])], views[-1], info)
    _frame(near, np.array((0.0, 0.0, 26.0)), 40.0, 'rocket_0 at the end of the flight')
    return figure


def _frame(axes: Any, centre: F64, reach: float, title: str) -> None:
    axes.set(
        xlim=(centre[0] - reach, centre[0] + reach), ylim=(centre[1] - reach, centre[1] + reach),
        zlim=(centre[2] - reach, centre[2] + reach), facecolor=_INK)
    axes.set_box_aspect((1, 1, 1), zoom=1.5)
    axes.view_init(elev=14, azim=-52)
    axes.set_axis_off()
    axes.computed_zorder = False
    axes.set_title(title, color='white', y=0.06)


def _draw(axes: Any, markers: Sequence[Marker], view: RocketView, info: WorldInfo) -> None:
    """Draw the model at a state, and markers in the world."""
    for part in vehicle_model(info).shapes:
        _polygons(axes, [
            _in_world(face, view) for face in _faces(part)], [part.colour], 1.0, _VEHICLE,
            shade=True)
    for marker in markers:
        if marker.hidden:
            continue
        if marker.shape == Shape.TRIANGLES and marker.points is not None:
            _polygons(
                axes, list(_in_world(marker.points, view).reshape(-1, 3, 3)),
                marker.colours[::3], marker.opacity, _FRONT)
        elif marker.shape == Shape.CYLINDER:
            radius = marker.size[0] / 2
            angle = np.linspace(0.0, 2 * np.pi, 4 * _SIDES)
            disc = np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1) * radius
            _polygons(axes, [disc + marker.position], marker.colours, marker.opacity, _GROUND)
        elif marker.shape == Shape.TEXT:
            axes.text(*marker.position, marker.text, color=_colour(marker.colours[0]),
                      ha='center', va='bottom', fontsize=9, zorder=_FRONT)
        elif marker.points is not None:
            _lines(axes, marker)


def _lines(axes: Any, marker: Marker) -> None:
    assert marker.points is not None
    colours = [_colour(one) for one in marker.colours]
    if marker.shape == Shape.SPHERE_LIST:
        axes.scatter(*marker.points.T, c=colours, s=40, depthshade=False, zorder=_FRONT)
        return
    step = 2 if marker.shape == Shape.LINE_LIST else 1
    pairs = np.stack((marker.points[:-1], marker.points[1:]), axis=1)[::step]
    if len(colours) == len(marker.points):
        colours = colours[1:]
    axes.add_collection3d(Line3DCollection(
        pairs, colors=colours, linewidths=1.8,
        zorder=_FRONT if marker.shape == Shape.ARROW else _LINES))


def _polygons(
    axes: Any, faces: Sequence[F64], colours: Sequence[palette.Colour], opacity: float,
    order: int, shade: bool = False,
) -> None:
    found = [_colour(one) for one in colours]
    axes.add_collection3d(Poly3DCollection(
        faces, facecolors=found if len(found) == len(faces) else found[0], alpha=opacity,
        shade=shade, zorder=order, linewidths=0.0, edgecolors='none' if not shade else found[0]))


def _colour(colour: palette.Colour) -> tuple[float, ...]:
    return tuple(part / 255 for part in colour)


def _in_world(points: F64, view: RocketView) -> F64:
    turned = frames.to_world(np.tile(view.orientation, (len(points), 1)), points)
    return np.asarray(turned + view.position)


def _faces(part: Part) -> list[F64]:
    """Return the faces of a part in the body frame."""
    if len(part.size) == 2:
        radius, length = part.size
        angle = np.linspace(0.0, 2 * np.pi, _SIDES + 1)
        ring = np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1) * radius
        low, high = ring - (0.0, 0.0, length / 2), ring + (0.0, 0.0, length / 2)
        faces = [np.array((low[k], low[k + 1], high[k + 1], high[k])) for k in range(_SIDES)]
        faces += [low[:-1], high[:-1]]
    else:
        half = np.array(part.size) / 2
        faces = []
        for axis in range(3):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            for side in (-1.0, 1.0):
                face = np.zeros((4, 3))
                face[:, axis] = side * half[axis]
                face[:, a] = half[a] * np.array((-1, 1, 1, -1))
                face[:, b] = half[b] * np.array((-1, -1, 1, 1))
                faces.append(face)
    return [np.asarray(face @ _turn(part.turned).T + part.at) for face in faces]


def _turn(angles: tuple[float, float, float]) -> F64:
    """Return the rotation by roll, pitch and yaw about fixed axes, as URDF defines it."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    roll = np.array(((1, 0, 0), (0, cr, -sr), (0, sr, cr)))
    pitch = np.array(((cp, 0, sp), (0, 1, 0), (-sp, 0, cp)))
    yaw = np.array(((cy, -sy, 0), (sy, cy, 0), (0, 0, 1)))
    return np.asarray(yaw @ pitch @ roll)
