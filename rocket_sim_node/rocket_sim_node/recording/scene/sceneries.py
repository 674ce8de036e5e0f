# SPDX-License-Identifier: Apache-2.0
"""How each world looks: a scenery by the world's name."""
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
    """What a recording of a world consists of, beside what all have.

    `static` logs what stands still, at the head of a recording; each of `effects` logs what a
    flight does to an entity of its own. `plots` are shown, `unseen` is recorded beside them, so
    that a sample has the same fields in every world, as one component must. Lengths are in heights
    of the vehicle's origin above the ground when it stands: `label` is where the outcome is
    written above the origin, `velocity` and `thrust` are the arrows of 1 m/s and of full throttle
    (there is none when it is 0), and at the end of a flight an origin within `reach` of the ground
    has touched it. `bends` is how many points a piece of the trail has between its ends; `legs` is
    how many legs a sample must tell of.
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
        return self.plots + self.unseen


def _log_rocket(stream: rr.RecordingStream, stage: WorldInfo) -> None:
    """Log ground, pad and vehicle in three dimensions."""
    entities.log_styles(
        stream, stage, unit=0.35 * stage.scale, mark=0.8, nose=rocket_model.NOSE * stage.scale)
    ground.log_ground(stream, stage)
    body = entities.archetype(transform(rocket_model.rocket(), stage.scale))
    stream.log(entities.BODY, body, static=True)
    effects.log_body(stream, stage.scale)
    contact_log.log_style(stream, stage)


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
    """Return how a world looks; one that nobody has drawn looks like `rocket`."""
    return SCENERIES.get(world, SCENERIES['rocket'])
