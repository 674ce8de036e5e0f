# SPDX-License-Identifier: Apache-2.0
"""Viewer layout of a comparison: a row of views, one per pilot, above overlaid plots."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol
from typing import cast

import rerun.blueprint as rrb

from rocket_sim_node.recording.comparison import overlaid_plots
from rocket_sim_node.recording.comparison.overlaid_plots import Named
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.scene.blueprint import UntimedBlueprint
from rocket_sim_node.recording.scene.blueprint import around_cursor
from rocket_sim_node.recording.scene.blueprint import lines
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

RESULTS = '/results'


class Titled(Named, Protocol):
    """Interface of a compared pilot that the layout needs."""

    @property
    def title(self) -> str:
        """The heading of its view."""
        ...


def blueprint(sides: Sequence[Titled], info: WorldInfo) -> UntimedBlueprint:
    """Return the layout of a comparison."""
    phases = rrb.StateTimelineView(
        name='Phases', origin='/', contents=[f'/{side.key}{entities.PHASE}' for side in sides])
    phases.properties['TimeAxis'] = around_cursor()
    log = rrb.TextLogView(
        name='Log', origin='/', contents=[f'/{side.key}{entities.LANDINGS}' for side in sides])
    plots = [
        _plot(plot, sides, legend=number == 0)
        for number, plot in enumerate(overlaid_plots.plots(info))]
    results = rrb.TextDocumentView(name='Results', origin=RESULTS, contents=[RESULTS])
    return UntimedBlueprint(
        rrb.Vertical(
            rrb.Horizontal(*(_view(side, info) for side in sides)),
            rrb.Horizontal(
                rrb.Grid(*plots, phases, grid_columns=3),
                rrb.Tabs(results, log, active_tab=0), column_shares=[5, 3]),
            row_shares=[8, 7]),
        rrb.BlueprintPanel(state='collapsed'),
        rrb.SelectionPanel(state='collapsed'),
        rrb.TimePanel(state='collapsed', timeline='sim_time', play_state='playing'))


def _view(side: Titled, info: WorldInfo) -> rrb.View:
    """Return the world's own view, placed at the pilot's copy of the scene."""
    view = scenery(info.world).view()
    path = f'/{side.key}'
    view.name = side.title
    view.origin = f'{path}{view.origin}'
    rules = cast(Sequence[str], view.contents)
    view.contents = [rule.replace('/', f'{path}/', 1) for rule in rules]
    view.visualizer_overrides = {
        f'{path}{entity}': how for entity, how in view.visualizer_overrides.items()}
    return view


def _plot(plot: Plot, sides: Sequence[Titled], *, legend: bool) -> rrb.TimeSeriesView:
    """Return the plot of a quantity, one line per pilot, some seconds around the cursor."""
    shown = lines(plot, styled=False)
    entities = [overlaid_plots.entity(side) for side in sides]
    return rrb.TimeSeriesView(
        name=plot.title, origin='/', contents=entities, axis_x=around_cursor(),
        overrides=dict.fromkeys(entities, shown),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=legend))
