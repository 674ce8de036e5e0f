# SPDX-License-Identifier: Apache-2.0
"""How the viewer shows a recording: the landing on the left, its numbers on the right.

Every entity and component of a blueprint costs the file some kilobytes, so a plot is one
component of the rocket's entity, and legends and bounds are left to the viewer where they are
good enough.
"""
from __future__ import annotations

from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind
from rerun.blueprint.encodings import VisualizerComponentMapping

from rocket_sim_node.recording import palette
from rocket_sim_node.recording import scene
from rocket_sim_node.recording.palette import Colour
from rocket_sim_node.recording.training_log import CURVES

PLOT_BEHIND = 12.0
PLOT_AHEAD = 3.0
TRAIL_SECONDS = 5.0
PATH_SECONDS = 60.0
PATH_ITERATIONS = 5


@dataclass(frozen=True)
class Plot:
    """A plot of the rocket's entity: one component, and its lines' names and colours."""

    title: str
    component: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...]


PLOTS = (
    Plot('Height and speed', 'Flight:motion', ('height (m)', 'speed (m/s)'),
         (palette.SKY, palette.ORANGE)),
    Plot('Tilt (deg)', 'Flight:tilt', ('tilt',), (palette.PURPLE,)),
    Plot('Throttle and fuel (%)', 'Flight:engine', ('throttle', 'fuel'),
         (palette.BURN, palette.SKY)),
    Plot('Reward', 'Flight:reward', ('return so far', 'reward of the step'),
         (palette.GREEN, palette.GREY)),
)


TABS = ('flight', 'log', 'training')


def blueprint(
    live: bool = False, training: bool = False, tab: str = 'flight',
) -> rrb.Blueprint:
    """Return the layout of a recording.

    :param live: follow what arrives instead of playing from the start.
    :param training: with a tab for an agent that trains.
    :param tab: the one of :data:`TABS` in front.
    """
    tabs: list[rrb.Container | rrb.View] = [_flight_tab(), _log_view()]
    if training:
        tabs.append(_training_tab())
    timeline = 'iteration' if tab == 'training' else 'sim_time'
    return rrb.Blueprint(
        rrb.Horizontal(
            _landing_view(), rrb.Tabs(*tabs, active_tab=TABS.index(tab)), column_shares=[3, 2]),
        rrb.BlueprintPanel(state='collapsed'),
        rrb.SelectionPanel(state='collapsed'),
        rrb.TimePanel(
            state='collapsed', timeline=timeline,
            play_state='following' if live else 'playing'),
    )


def _landing_view() -> rrb.Spatial3DView:
    """Return the 3-D view, whose frame follows the camera entity."""
    boundary = rrb.TimeRangeBoundary
    now = boundary.cursor_relative()

    def since(**starts: rr.encodings.TimeRangeBoundary) -> rrb.VisibleTimeRanges:
        return rrb.VisibleTimeRanges([
            rrb.VisibleTimeRange(timeline, start=start, end=now)
            for timeline, start in starts.items()])

    always = boundary.infinite()
    marks = since(sim_time=always, step=always, iteration=always)
    paths = since(
        sim_time=boundary.cursor_relative(seconds=-PATH_SECONDS),
        iteration=boundary.cursor_relative(seq=-PATH_ITERATIONS))
    trail = since(sim_time=boundary.cursor_relative(seconds=-TRAIL_SECONDS))
    return rrb.Spatial3DView(
        name='Landing', origin=scene.CAMERA, contents=['+ /world/**', f'+ {scene.CAMERA}'],
        background=list(palette.BACKGROUND), line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(1.05, -1.60, 0.42), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)),
        overrides={scene.LANDINGS: marks, scene.PATHS: paths, scene.TRAIL: trail},
    )


def _around_cursor() -> rrb.TimeAxis:
    return rrb.TimeAxis(view_range=rr.TimeRange(
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-PLOT_BEHIND),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=PLOT_AHEAD)))


def _flight_tab() -> rrb.Vertical:
    """Return the plots of a flight, some seconds around the cursor."""
    views = [
        rrb.TimeSeriesView(
            name=plot.title, origin=scene.ROCKET, contents=[scene.ROCKET],
            axis_x=_around_cursor(), overrides={scene.ROCKET: _lines(plot)})
        for plot in PLOTS]
    phase = rrb.StateTimelineView(name='Phase', origin=scene.PHASE, contents=[scene.PHASE])
    # It has a time axis like the plots, but its constructor has no argument for it.
    phase.properties['TimeAxis'] = _around_cursor()
    return rrb.Vertical(
        *views, phase, name='Flight', row_shares=[3, 2, 2, 2, 1.2])


def _lines(plot: Plot) -> rrb.Visualizer:
    return rr.SeriesLines(
        names=list(plot.names), colors=list(plot.colours), widths=[2.0] * len(plot.names),
    ).visualizer(mappings=[VisualizerComponentMapping(
        'Scalars:scalars', ComponentSourceKind.SourceComponent,
        source_component=plot.component)])


def _training_tab() -> rrb.Vertical:
    """Return the curves of a training run."""
    views = []
    for entity, (title, _) in CURVES.items():
        path = f'{scene.TRAINING}/{entity}'
        views.append(rrb.TimeSeriesView(name=title, origin=path, contents=[path]))
    return rrb.Vertical(
        rrb.Grid(*views, grid_columns=2),
        rrb.StateTimelineView(
            name='Stage', origin=scene.TRAINING_STAGE, contents=[scene.TRAINING_STAGE]),
        name='Training', row_shares=[9, 1])


def _log_view() -> rrb.TextLogView:
    """Return the log of outcomes and stages."""
    return rrb.TextLogView(name='Log', origin=scene.LOG, contents=[scene.LOG, scene.LANDINGS])
