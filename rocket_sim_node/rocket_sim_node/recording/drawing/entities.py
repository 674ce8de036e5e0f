# SPDX-License-Identifier: Apache-2.0
"""Entity paths of a recording, and the styles of moving entities, logged once at its start."""
from __future__ import annotations

import rerun as rr

from rocket_sim_node import palette
from rocket_sim_node.recording.drawing.geometry import Mesh
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

WORLD = '/world'
GROUND = '/world/ground'
TERRAIN = '/world/terrain'
SURFACE = '/world/terrain/surface'
ROCKET = '/world/rocket'
BODY = '/world/rocket/body'
LEGS = ('/world/rocket/leg_left', '/world/rocket/leg_right')
FLAME = '/world/rocket/flame'
PUFF = '/world/rocket/puff'
DISTURBANCE = '/world/rocket/disturbance'
CONTACT = '/world/contact'
TRAIL = '/world/trail'
PATHS = '/world/paths'
LANDINGS = '/world/landings'
CAMERA = '/camera'
PHASE = '/world/phase'
LOG = '/log'
CONDITIONS = '/conditions'
TRAINING = '/training'
TRAINING_STAGE = '/training/stage'

WORLD_NAME = 'World:name'
"""Component of :data:`WORLD` with the name of the world."""

_VELOCITY: palette.Colour = palette.SKY
_THRUST: palette.Colour = palette.ORANGE


def log_styles(
    stream: rr.RecordingStream, info: WorldInfo, *, unit: float, mark: float,
    in_front: float = 0.0,
    nose: float | None = None,
) -> None:
    """Log the world's name, and the styles of entities that will move.

    :param unit: m, radius of the vehicle's arrows.
    :param mark: m, radius of the marks of touchdowns.
    :param in_front: m, distance of the arrows in front of the vehicle.
    :param nose: m, height in the body frame at which the thrust arrow begins, if there is one.
    """
    origins = [(0.0, -in_front, height) for height in (0.0, nose) if height is not None]
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, rr.DynamicArchetype(
        'World', components={'name': [info.world]}), static=True)
    stream.log(
        ROCKET, rr.Arrows3D.from_fields(
            colors=[_VELOCITY, _THRUST][:len(origins)], radii=[unit], origins=origins),
        static=True)
    stream.log(
        TRAIL, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.5)), static=True)
    stream.log(
        PATHS, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.2)), static=True)
    stream.log(LANDINGS, rr.Points3D.from_fields(radii=mark), static=True)
    colours = {
        **palette.PHASES, **palette.VERDICTS, **palette.outcome_colours(info.outcomes)}
    stream.log(PHASE, rr.StateConfiguration(
        values=list(colours), labels=[palette.words(name) for name in colours],
        colors=list(colours.values())),
        rr.Points3D.from_fields(radii=0.01), static=True)


def archetype(mesh: Mesh, shaded: bool = True, opacity: int = 255) -> rr.Mesh3D:
    """Return a mesh as a Rerun archetype; without normals it is drawn unshaded."""
    return rr.Mesh3D(
        vertex_positions=mesh.position, triangle_indices=mesh.triangle,
        vertex_normals=mesh.normal if shaded else None, vertex_colors=mesh.colour,
        albedo_factor=(255, 255, 255, opacity) if opacity < 255 else None)
