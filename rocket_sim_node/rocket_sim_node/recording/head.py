# SPDX-License-Identifier: Apache-2.0
"""What stands at the head of a recording: the scene, and the styles of what will come."""
from __future__ import annotations

import rerun as rr

from rocket_sim_node.recording import conditions_log
from rocket_sim_node.recording import plots
from rocket_sim_node.recording import scene
from rocket_sim_node.recording import training_log
from rocket_sim_node.recording.backdrop import BEFORE_FLIGHT
from rocket_sim_node.recording.backdrop import BEFORE_TRAINING
from rocket_sim_node.recording.backdrop import log_backdrop
from rocket_sim_node.recording.sceneries import scenery
from rocket_sim_node.recording.sink import Look
from rocket_sim_node.recording.sink import Put
from rocket_sim_node.recording.stage import Stage


def head(stage: Stage, look: Look, live: bool) -> Put:
    """Return what logs the head of a recording of a world.

    :param look: what the recording shows.
    :param live: with something to be seen until the first flight begins.
    """
    def put(stream: rr.RecordingStream) -> None:
        shown = scenery(stage.world)
        shown.static(stream, stage)
        plots.log_styles(stream, scene.ROCKET, shown.recorded)
        if look.unusual:
            conditions_log.log_style(stream, stage)
        if look.training:
            training_log.log_styles(stream)
            log_backdrop(stream, stage, BEFORE_TRAINING)
        if live:
            log_backdrop(stream, stage, BEFORE_FLIGHT)

    return put
