# SPDX-License-Identifier: Apache-2.0
"""Start of a recording: the static scene, and the styles of what follows."""
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


def head(info: WorldInfo, look: Look, live: bool) -> Put:
    """Return a function that logs the start of a world's recording.

    :param look: layout of the recording.
    :param live: whether to show a vehicle until the first flight begins.
    """
    def put(stream: rr.RecordingStream) -> None:
        shown = scenery(info.world)
        shown.static(stream, info)
        plots.log_styles(stream, entities.ROCKET, shown.recorded)
        if look.unusual:
            conditions_log.log_style(stream, info)
        if look.training:
            training_plots.log_styles(stream)
            log_backdrop(stream, info, BEFORE_TRAINING)
        if live:
            log_backdrop(stream, info, BEFORE_FLIGHT)

    return put
