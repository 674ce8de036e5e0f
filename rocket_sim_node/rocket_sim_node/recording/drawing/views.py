# SPDX-License-Identifier: Apache-2.0
"""3-D view of the landing, and the time ranges that views show."""
from __future__ import annotations

from collections.abc import Mapping

import rerun as rr
import rerun.blueprint as rrb

from rocket_sim_node import palette
from rocket_sim_node.recording.drawing import entities

TRAIL_SECONDS = 5.0
PATH_SECONDS = 60.0
PATH_ITERATIONS = 5


def histories() -> Mapping[rr.EntityPath | str, rrb.VisibleTimeRanges]:
    """Return how long marks, paths and the trail stay visible, by entity."""
    boundary = rrb.TimeRangeBoundary
    now = boundary.cursor_relative()

    def since(**starts: rr.encodings.TimeRangeBoundary) -> rrb.VisibleTimeRanges:
        return rrb.VisibleTimeRanges([
            rrb.VisibleTimeRange(timeline, start=start, end=now)
            for timeline, start in starts.items()])

    always = boundary.infinite()
    return {
        entities.LANDINGS: since(sim_time=always, step=always, iteration=always),
        entities.PATHS: since(
            sim_time=boundary.cursor_relative(seconds=-PATH_SECONDS),
            iteration=boundary.cursor_relative(seq=-PATH_ITERATIONS)),
        entities.TRAIL: since(sim_time=boundary.cursor_relative(seconds=-TRAIL_SECONDS)),
    }


def spatial_view() -> rrb.Spatial3DView:
    """Return the 3-D view, whose frame follows the camera entity."""
    return rrb.Spatial3DView(
        name='Landing', origin=entities.CAMERA, contents=['+ /world/**', f'+ {entities.CAMERA}'],
        background=list(palette.BACKGROUND), line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(1.05, -1.60, 0.42), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)),
        overrides=histories(),
    )
