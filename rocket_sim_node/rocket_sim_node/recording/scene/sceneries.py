# SPDX-License-Identifier: Apache-2.0
"""Registry of sceneries: the appearance of each world, by name."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import rerun as rr
import rerun.blueprint as rrb

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import planar_view
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing import views
from rocket_sim_node.recording.drawing.geometry import transform
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.scene import camera
from rocket_sim_node.recording.scene import contact_log
from rocket_sim_node.recording.scene import effects
from rocket_sim_node.recording.scene import ground
from rocket_sim_node.recording.scene import lunar_lander
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.scene import rocket_planar
from rocket_sim_node.recording.scene.camera import Camera
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import DRAWN_HEIGHT
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

Effect: TypeAlias = Callable[[rr.RecordingStream, Trajectory, WorldInfo, Timepoint], None]


@dataclass(frozen=True)
class Scenery:
    """World-specific parts of a recording.

    `static` logs the static scene at the start of a recording; each of `effects` logs a flight's
    effect on one entity. `plots` are shown; `unseen` are only recorded, so that a sample has the
    same fields in every world, as a component must. Lengths are in standing heights of the
    vehicle's origin: `label` is the height of the outcome's label above the origin, `velocity` and
    `thrust` the arrows of 1 m/s and of full throttle (no arrow if 0). An origin within `reach` of
    the ground at the end of a flight has touched it. `bends` is the number of points between the
    ends of a piece of the trail; `legs` is the number of legs that a sample must have.
    """

    view: Callable[[], rrb.View]
    plots: tuple[Plot, ...]
    camera: Camera
    static: Callable[[rr.RecordingStream, WorldInfo], None]
    effects: tuple[Effect, ...]
    label: float
    velocity: float
    thrust: float = 0.0
    reach: float = 1.0
    bends: int = 0
    legs: int = 0
    unseen: tuple[Plot, ...] = ()

    @property
    def recorded(self) -> tuple[Plot, ...]:
        """The fields of a sample."""
        return self.plots + self.unseen + plots.EVERYWHERE


def _log_rocket(stream: rr.RecordingStream, info: WorldInfo) -> None:
    """Log ground, pad and vehicle in three dimensions."""
    entities.log_styles(
        stream, info, unit=0.35 * info.scale, mark=0.8, nose=rocket_model.NOSE * info.scale)
    ground.log_ground(stream, info)
    body = entities.archetype(transform(rocket_model.rocket(), info.scale))
    stream.log(entities.BODY, body, static=True)
    effects.log_body(stream, info.scale)
    contact_log.log_style(stream, info)


SCENERIES: Mapping[str, Scenery] = {
    'rocket': Scenery(
        view=views.spatial_view,
        plots=(plots.MOTION, plots.TILT, plots.ENGINE, plots.REWARD),
        camera=camera.SPATIAL, static=_log_rocket,
        effects=(effects.log_flame, effects.log_puffs, contact_log.log_contact),
        label=(rocket_model.NOSE + 5.0) / DRAWN_HEIGHT,
        velocity=0.9 / DRAWN_HEIGHT, thrust=16.0 / DRAWN_HEIGHT, unseen=(plots.CONTACT,)),
    'rocket_planar': Scenery(
        view=planar_view.view,
        plots=(plots.MOTION, plots.TILT, plots.ENGINE, plots.REWARD, plots.CONTACT),
        camera=Camera(camera.follow, planar_view.columns), static=rocket_planar.log_static,
        effects=(effects.log_flame, effects.log_puffs, rocket_planar.log_contact),
        label=(rocket_model.NOSE + 5.0) / DRAWN_HEIGHT, velocity=0.9 / DRAWN_HEIGHT),
    'lunar_lander': Scenery(
        view=lambda: planar_view.view(lunar_lander.ASPECT),
        plots=(plots.MOTION, plots.TILT, plots.ENGINES, plots.REWARD, plots.CONTACT),
        camera=Camera(lunar_lander.frame, planar_view.columns, follows=False),
        static=lunar_lander.log_static,
        effects=(
            planar_view.log_terrain, lunar_lander.log_legs, lunar_lander.log_flame,
            lunar_lander.log_side_engines,
            lunar_lander.log_contact),
        label=lunar_lander.LABEL, velocity=lunar_lander.VELOCITY, reach=2.0, bends=3, legs=2),
}


def scenery(world: str) -> Scenery:
    """Return the scenery of a world; the default is that of `rocket`."""
    return SCENERIES.get(world, SCENERIES['rocket'])
