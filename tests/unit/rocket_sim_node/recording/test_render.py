# SPDX-License-Identifier: Apache-2.0
"""The viewer draws every world, the training and a comparison without errors."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind
from rerun.blueprint.encodings import VisualizerComponentMapping
from support.recording import rendering
from support.recording.recordings import record

from ppo_agent_node.commands import recorded_flights
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds
from rocket_sim_node.recording import reader
from rocket_sim_node.recording import render
from rocket_sim_node.recording.comparison import comparison
from rocket_sim_node.recording.comparison.comparison import Side
from rocket_sim_node.recording.drawing.training_plots import LINES
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.samples import Samples

SEED = 3


def flown(world: str) -> tuple[WorldInfo, Samples]:
    """Return a world and one flight of its scripted pilot that landed, as most do."""
    simulated = worlds.make(world, 1)
    spec = simulated.spec
    stage = WorldInfo.build(spec.name, spec.dt, spec.outcomes, spec.settings)
    for seed in range(SEED, SEED + 10):
        samples = recorded_flights.fly(simulated, scripted_pilot(spec), seed)
        if spec.outcomes.index('landed') in samples.outcome:
            return stage, samples
    raise AssertionError('none landed')


@pytest.mark.slow
@pytest.mark.parametrize('world', worlds.names())
def test_every_world_is_drawn(tmp_path: Path, world: str) -> None:
    path = tmp_path / 'run.rrd'
    stage, samples = flown(world)
    record(path, stage, samples, touchdown.follow)
    flight, = reader.trajectories(path)
    assert flight.outcome == 'landed'
    end = flight.start + float(flight.time[-1])
    high, low = rendering.pictures(path, [flight.start + 0.2 * float(flight.time[-1]), end + 1.0])
    heights = []
    for picture in (high, low):
        left = picture[60:, :int(0.55 * picture.shape[1])]
        right = picture[60:, int(0.65 * picture.shape[1]):]
        assert rendering.colours(left) > 100, 'no scene'
        assert rendering.colours(right) > 100, 'no plots'
        target = np.abs(left - (255, 206, 84)).sum(axis=2) < 30
        assert target.sum() > 20, 'no pad'
        vehicle = rendering.of_vehicle(left, world)
        assert vehicle.sum() > 5, 'no vehicle'
        heights.append(
            np.nonzero(target)[0].mean() - np.nonzero(vehicle)[0].mean())
    assert heights[0] > 0, 'the vehicle is above the pad'
    assert not np.array_equal(high, low)


@pytest.mark.slow
def test_training_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    stage, samples = flown('lunar_lander')

    class Learning(Recorder):
        """Receives reports of an agent before it receives flights."""

        def world(self, stage: WorldInfo) -> None:
            super().world(stage)
            for number in range(1, 40):
                self.training(Training(
                    'finetune', number, {line.value: float(np.sqrt(number)) for line in LINES}))

    record(path, stage, samples, kind=Learning)
    picture, = rendering.pictures(path, [39], tab='training')
    right = picture[60:, int(0.62 * picture.shape[1]):]
    curves = (right.max(axis=2) - right.min(axis=2) > 60).sum()
    assert curves > 300, 'no curves'


@pytest.mark.slow
def test_a_comparison_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / 'comparison.rrd'
    simulated = worlds.make('rocket', 1)
    spec = simulated.spec
    stage = WorldInfo.build(spec.name, spec.dt, spec.outcomes, spec.settings)
    flights = recorded_flights.flights(
        recorded_flights.fly(simulated, scripted_pilot(spec), SEED), spec.outcomes)
    idle = recorded_flights.flights(recorded_flights.fly(
        simulated, Idle(), SEED), spec.outcomes)
    sides = [
        Side('1_first', 'first', 'The first', flights), Side('2_idle', 'idle', 'Idle', idle)]
    comparison.write(path, sides, stage, touchdown.follow, 'Two **pilots**.')
    when = 5.2  # s: the first burns, and the other still falls
    picture, = rendering.pictures(path, [when], size=(1280, 800))
    rows, columns, _ = picture.shape
    for side, name in enumerate(('first', 'idle')):
        half = picture[30:rows // 2, side * columns // 2:(side + 1) * columns // 2]
        assert rendering.colours(half) > 100, name
        assert (np.abs(half - (255, 206, 84)).sum(axis=2) < 30).sum() > 20, f'{name}: no pad'
    left, right = (picture[30:rows // 2, part] for part in (
        slice(0, columns // 2), slice(columns // 2, None)))
    assert all(rendering.of_vehicle(half, 'rocket').sum() > 5 for half in (left, right))
    flame = [
        ((half[..., 0] > 200) & (half[..., 2] < 130) & (half[..., 1] > 60)
         & (np.abs(half - (255, 206, 84)).sum(axis=2) > 60)).sum() for half in (left, right)]
    assert flame[0] > flame[1], 'only the first burns'
    plots = picture[rows // 2 + 40:, :int(0.6 * columns)]
    assert (np.abs(plots - (230, 159, 0)).sum(axis=2) < 40).sum() > 50, 'no line of the second'
    assert (np.abs(plots - (235, 238, 242)).sum(axis=2) < 20).sum() > 50, 'no line of the first'


class Idle:
    """Lets the rocket fall."""

    name = 'idle'

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return np.tile(np.array((-1, 0, 0), np.float32), (len(observation), 1))


def test_errors_of_the_viewer_are_reported(tmp_path: Path) -> None:
    """A plot that asks for a part which its component does not have."""
    path = tmp_path / 'bad.rrd'
    lines = rr.SeriesLines().visualizer(mappings=[VisualizerComponentMapping(
        'Scalars:scalars', ComponentSourceKind.SourceComponent, source_component='A:b',
        selector='.missing')])
    stream = rr.RecordingStream('test')
    stream.save(path, default_blueprint=rrb.Blueprint(rrb.TimeSeriesView(
        name='Broken', origin='/a', contents=['/a'], overrides={'/a': lines})))
    stream.send_columns(
        '/a', [rr.TimeColumn('sim_time', duration=np.arange(9.0))],
        rr.DynamicArchetype.columns('A', components={'b': np.arange(9.0)}))
    stream.flush()
    stream.disconnect()
    with pytest.raises(rerun_program.ViewerError, match='the viewer reports: Broken'):
        rendering.pictures(path, [3.0])


def test_a_missing_driver_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a driver a test is skipped, but it fails where CI is set."""
    path = tmp_path / 'run.rrd'
    record(path, *flown('lunar_lander'))
    monkeypatch.setenv('VK_ICD_FILENAMES', '/nowhere.json')
    monkeypatch.setenv('VK_DRIVER_FILES', '/nowhere.json')
    monkeypatch.setenv('LIBGL_ALWAYS_SOFTWARE', '1')
    monkeypatch.setenv('__EGL_VENDOR_LIBRARY_FILENAMES', '/nowhere.json')
    with pytest.raises(render.RendererMissing, match='mesa-vulkan-drivers') as missing:
        render.render(path, [1.0])

    def fail(*how: object, **more: object) -> None:
        raise missing.value

    monkeypatch.setattr(render, 'render', fail)
    monkeypatch.setenv('CI', 'true')
    with pytest.raises(render.RendererMissing):
        rendering.pictures(path, [1.0])
    monkeypatch.delenv('CI')
    with pytest.raises(pytest.skip.Exception, match='mesa-vulkan-drivers'):
        rendering.pictures(path, [1.0])
