# SPDX-License-Identifier: Apache-2.0
"""Viewer layout of a recording: the landing on the left, its values on the right.

Every component of a blueprint adds 0.7 KiB to the file and every entity 1 to 2 KiB. So a plot is
one field of the rocket's samples, and legends and bounds have the viewer's defaults where
possible.
"""
from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind
from rerun.blueprint.encodings import VisualizerComponentMapping

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.plots import EVERYWHERE
from rocket_sim_node.recording.drawing.plots import STYLES
from rocket_sim_node.recording.drawing.plots import UNUSUALS
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.telemetry.training_status import PLOTS

PLOT_BEHIND = 12.0
PLOT_AHEAD = 3.0

TABS = ('flight', 'log', 'training', 'conditions')


class UntimedBlueprint(rrb.Blueprint):
    """A blueprint without the creation time of each of its parts.

    That time is never used, and its columns take up 14 KiB in the index of every recording.
    """

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        stream.set_log_time_enabled(False)
        super()._log_to_stream(stream)


def blueprint(
    live: bool = False, training: bool = False, unusual: bool = False, tab: str = 'flight',
    world: str = '',
) -> UntimedBlueprint:
    """Return the layout of a recording.

    :param live: follow new data instead of playing from the start.
    :param training: with a tab for training.
    :param unusual: with a tab for conditions that are not nominal.
    :param tab: the one of :data:`TABS` in front.
    :param world: name of the recorded world.
    """
    look = scenery(world)
    tabs: dict[str, rrb.Container | rrb.View] = {
        'flight': _flight_tab(look.plots + EVERYWHERE, unusual=unusual), 'log': _log_view()}
    if training:
        tabs['training'] = _training_tab()
    if unusual:
        tabs['conditions'] = _conditions_tab()
    timeline = 'iteration' if tab == 'training' else 'sim_time'
    return UntimedBlueprint(
        rrb.Horizontal(
            look.view(),
            rrb.Tabs(*tabs.values(), active_tab=list(tabs).index(tab) if tab in tabs else 0),
            column_shares=[3, 2]),
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


def without_origin(view: rrb.View) -> rrb.View:
    """Remove a view's origin: its contents list everything that it shows."""
    view.origin = None  # type: ignore[assignment]  # then not logged, and the viewer's is /
    return view


def _flight_tab(plots: tuple[Plot, ...], *, unusual: bool) -> rrb.Vertical:
    """Return the plots of a flight, some seconds around the cursor.

    :param unusual: with those for conditions that are not nominal, where they lie behind others.
    """
    shares = [3, *[2] * (len(plots) - 1)]
    views = [
        _plot_view(plot.title, *(
            other for other in UNUSUALS if unusual and other.behind == plot.name), plot)
        for plot in plots]
    phase = without_origin(rrb.StateTimelineView(name='Phase', contents=[entities.PHASE]))
    # It supports a time axis like the plots, but its constructor has no argument for it.
    phase.properties['TimeAxis'] = around_cursor()
    return rrb.Vertical(
        *views, phase, name='Flight', row_shares=[*shares, sum(shares) * 2 / 15])


def _plot_view(title: str, *plots: Plot) -> rrb.View:
    """Return a view of plots, the last one in front."""
    return without_origin(rrb.TimeSeriesView(
        name=title, contents=[entities.ROCKET], axis_x=around_cursor(),
        overrides={entities.ROCKET: [lines(plot) for plot in plots]}))


def _conditions_tab() -> rrb.Vertical:
    """Return the view of a flight's drawn conditions and of its disturbances."""
    views = [_plot_view(plot.title, plot) for plot in UNUSUALS if not plot.behind]
    return rrb.Vertical(
        without_origin(rrb.TextDocumentView(name='Drawn', contents=[entities.CONDITIONS])),
        *views, name='Conditions', row_shares=[3, *[2] * len(views)])


def lines(plot: Plot, *, styled: bool = True) -> rrb.Visualizer:
    """Return the visualizer that draws a plot's field of the records as lines.

    :param styled: with the style of :func:`plots.log_styles`, otherwise with the entity's.
    """
    sources = {'Scalars:scalars': plot.records, **(STYLES[plot.records] if styled else {})}
    return rr.SeriesLines().visualizer(mappings=[
        VisualizerComponentMapping(
            target, ComponentSourceKind.SourceComponent, source_component=component,
            selector=plot.selector)
        for target, component in sources.items()])


def _training_tab() -> rrb.Vertical:
    """Return the curves of a training run."""
    views = [
        without_origin(rrb.TimeSeriesView(name=title, contents=[f'{entities.TRAINING}/{entity}']))
        for entity, title in PLOTS.items()]
    return rrb.Vertical(
        rrb.Grid(*views, grid_columns=2),
        without_origin(rrb.StateTimelineView(name='Stage', contents=[entities.TRAINING_STAGE])),
        name='Training', row_shares=[9, 1])


def _log_view() -> rrb.View:
    """Return the log of outcomes and stages."""
    return without_origin(rrb.TextLogView(name='Log', contents=[entities.LOG, entities.LANDINGS]))
