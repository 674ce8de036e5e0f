# SPDX-License-Identifier: Apache-2.0
"""What stands at the head of a recording: the scene, and the styles of what will come."""
from __future__ import annotations

import rerun as rr

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing import training_plots
from rocket_sim_node.recording.scene import conditions_log
from rocket_sim_node.recording.scene.backdrop import BEFORE_FLIGHT
from rocket_sim_node.recording.scene.backdrop import BEFORE_TRAINING
from rocket_sim_node.recording.scene.backdrop import log_backdrop
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.sinks.base import Look
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.trajectories.world_info import WorldInfo


def head(stage: WorldInfo, look: Look, live: bool) -> Put:
    """Return what logs the head of a recording of a world.

    :param look: what the recording shows.
    :param live: with something to be seen until the first flight begins.
    """
    def put(stream: rr.RecordingStream) -> None:
        shown = scenery(stage.world)
        shown.static(stream, stage)
        plots.log_styles(stream, entities.ROCKET, shown.recorded)
        if look.unusual:
            conditions_log.log_style(stream, stage)
        if look.training:
            training_plots.log_styles(stream)
            log_backdrop(stream, stage, BEFORE_TRAINING)
        if live:
            log_backdrop(stream, stage, BEFORE_FLIGHT)

    return put
