# SPDX-License-Identifier: Apache-2.0
"""The samples of a recording that are plotted: their fields, their precision, their styles."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from support.recording.recordings import record

from ppo_agent_node.commands import recorded_flights
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds
from rocket_sim_node.recording import reader
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.scene.sceneries import SCENERIES
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.telemetry.samples import Samples


def stage_of(name: str) -> WorldInfo:
    spec = worlds.make(name, 1).spec
    return WorldInfo.build(name, spec.dt, spec.outcomes, spec.settings)


def standing(rows: int = 3) -> Trajectory:
    layout = Layout(legs=2)
    values = np.zeros((rows, layout.width))
    values[:, FIELDS['orientation'].stop - 1] = 1.0
    return Trajectory(0, 0, 0, '', values, layout)


def test_samples_have_the_same_fields_in_every_world() -> None:
    """One component has one type, and a recording may hold several worlds."""
    kinds = set()
    for name, look in SCENERIES.items():
        column, = plots.columns(look.recorded, standing(), stage_of(name))
        kinds.add(column.as_arrow_array().type)
    assert len(kinds) == 1
    assert set(SCENERIES) == set(worlds.names())


def test_rough_values_are_near_and_finite() -> None:
    values = np.array([0.0, 1e-3, 1 / 3, 199.9, 40_000.0, 1e9, -1e9, np.nan])
    rough = Plot('', 'x', ('x',), (), lambda flight, stage: (values,), rough=True)
    table = rough.table(standing(len(values)), stage_of('rocket'))[:, 0].astype(np.float64)
    np.testing.assert_allclose(table[:5], values[:5], rtol=5e-4)
    np.testing.assert_array_equal(table[5:7], (65_504, -65_504))
    assert np.isnan(table[7:]).all(), 'what is no number, and the gap at the end'


def landing(name: str) -> Samples:
    world = worlds.make(name, 1)
    return recorded_flights.fly(world, scripted_pilot(world.spec), 3)


@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_lines_have_names_and_colours(tmp_path: Path, world: str) -> None:
    path = tmp_path / 'run.rrd'
    record(path, stage_of(world), landing(world))
    styles = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entities.ROCKET and chunk.is_static:
            batch = chunk.to_record_batch()
            styles.update({
                name: batch.column(name).to_pylist()[0][0] for name in batch.schema.names
                if name in plots.STYLES[plots.SAMPLE].values()})
    for plot in SCENERIES[world].plots:
        assert styles['Flight:names'][plot.name] == list(plot.names)
        assert styles['Flight:colors'][plot.name] == [
            rr.encodings.Rgba32(colour).rgba for colour in plot.colours]


def test_older_recordings_with_a_component_for_each_plot_are_read(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = stage_of('rocket'), landing('rocket')

    def columns(
        shown: tuple[Plot, ...], flight: Trajectory, stage: WorldInfo,
    ) -> list[rr.ComponentColumn]:
        made: list[rr.ComponentColumn] = []
        for plot in shown:
            table = plot.table(flight, stage).astype(np.float32)
            made += rr.DynamicArchetype.columns(
                'Flight', components={plot.name: pa.array(table.ravel())},
            ).partition([table.shape[1]] * len(table))
        return made

    record(tmp_path / 'new.rrd', *flown)
    monkeypatch.setattr(plots, 'columns', columns)
    record(tmp_path / 'old.rrd', *flown)
    new, old = (reader.trajectories(tmp_path / f'{name}.rrd')[0] for name in ('new', 'old'))
    for name in ('position', 'velocity', 'tilt', 'throttle', 'fuel', 'reward'):
        np.testing.assert_array_equal(getattr(new, name), getattr(old, name), name)
    assert new.throttle.max() > 0.5
