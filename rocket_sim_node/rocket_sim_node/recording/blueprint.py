# SPDX-License-Identifier: Apache-2.0
"""How the viewer shows a recording: the landing on the left, its numbers on the right.

Every entity and component of a blueprint costs the file some kilobytes, so a plot is one
component of the rocket's entity, and legends and bounds are left to the viewer where they are
good enough.
"""
from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind
from rerun.blueprint.encodings import VisualizerComponentMapping

from rocket_sim_node.recording import scene
from rocket_sim_node.recording.plots import Plot
from rocket_sim_node.recording.sceneries import scenery
from rocket_sim_node.recording.training_log import CURVES

PLOT_BEHIND = 12.0
PLOT_AHEAD = 3.0

TABS = ('flight', 'log', 'training')


def blueprint(
    live: bool = False, training: bool = False, tab: str = 'flight', world: str = '',
) -> rrb.Blueprint:
    """Return the layout of a recording.

    :param live: follow what arrives instead of playing from the start.
    :param training: with a tab for an agent that trains.
    :param tab: the one of :data:`TABS` in front.
    :param world: what is recorded.
    """
    look = scenery(world)
    tabs: list[rrb.Container | rrb.View] = [_flight_tab(look.plots), _log_view()]
    if training:
        tabs.append(_training_tab())
    timeline = 'iteration' if tab == 'training' else 'sim_time'
    return rrb.Blueprint(
        rrb.Horizontal(
            look.view(), rrb.Tabs(*tabs, active_tab=TABS.index(tab)), column_shares=[3, 2]),
        rrb.BlueprintPanel(state='collapsed'),
        rrb.SelectionPanel(state='collapsed'),
        rrb.TimePanel(
            state='collapsed', timeline=timeline,
            play_state='following' if live else 'playing'),
    )


def around_cursor() -> rrb.TimeAxis:
    """Return the time axis of plots that show some seconds around the cursor."""
    return rrb.TimeAxis(view_range=rr.TimeRange(
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-PLOT_BEHIND),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=PLOT_AHEAD)))


def _flight_tab(plots: tuple[Plot, ...]) -> rrb.Vertical:
    """Return the plots of a flight, some seconds around the cursor."""
    shares = [3, *[2] * (len(plots) - 1)]
    views = [
        rrb.TimeSeriesView(
            name=plot.title, origin=scene.ROCKET, contents=[scene.ROCKET],
            axis_x=around_cursor(), overrides={scene.ROCKET: lines(plot, _style(plot))})
        for plot in plots]
    phase = rrb.StateTimelineView(name='Phase', origin=scene.PHASE, contents=[scene.PHASE])
    # It has a time axis like the plots, but its constructor has no argument for it.
    phase.properties['TimeAxis'] = around_cursor()
    return rrb.Vertical(
        *views, phase, name='Flight', row_shares=[*shares, sum(shares) * 2 / 15])


def lines(plot: Plot, style: rr.SeriesLines) -> rrb.Visualizer:
    """Return what draws the component of a plot as lines."""
    return style.visualizer(mappings=[VisualizerComponentMapping(
        'Scalars:scalars', ComponentSourceKind.SourceComponent,
        source_component=plot.component)])


def _style(plot: Plot) -> rr.SeriesLines:
    return rr.SeriesLines(
        names=list(plot.names), colors=list(plot.colours), widths=[2.0] * len(plot.names))


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
