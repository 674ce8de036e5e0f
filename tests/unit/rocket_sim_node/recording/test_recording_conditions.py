# SPDX-License-Identifier: Apache-2.0
"""Recordings of flights under nominal and under other conditions."""
from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation
from support.recording.recordings import record
from support.recording.recordings import rows_of
from support.recording.recordings import view_classes

from rocket_sim_node.recording import reader
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.scene import conditions_log
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.rewrite import rewrite
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket.conditions import DRAWN_NAMES
from rocket_sim_node.worlds.rocket.conditions import RANGES

N = 40
NOMINAL = conditions.settings('nominal')
TOWARDS = {'rocket': 'towards 300° from x', 'rocket_planar': '0.25 along x'}
"""Half a m/s^2, drawn 60 deg from x towards z, y up: towards -y, z up, of which none is planar."""


def stage(world: str = 'rocket', names: tuple[str, ...] = DRAWN_NAMES) -> WorldInfo:
    """A world of rockets."""
    return WorldInfo(world, 0.02, ('landed', 'too_fast'), condition_names=names)


def flight(episode: int = 0, width: int = len(DRAWN_NAMES), **drawn: float) -> Samples:
    """A flight of N samples that swings to and fro; the wind blows where it was drawn.

    The engine gives half of what is commanded.
    """
    k = np.arange(N)
    lean = 0.3 * np.sin(0.2 * k)
    values = {name: np.zeros((N, place.stop - place.start)) for name, place in FIELDS.items()}
    values['time'] = 0.02 * k
    values['position'] = np.stack((0.1 * k, 0.05 * k, 300.0 - k), axis=1)
    values['orientation'] = Rotation.from_euler('xy', np.stack((lean, -lean), axis=1)).as_quat()
    values['mass'], values['fuel'] = np.full(N, 24_000.0), np.full(N, 2_000.0)
    values['throttle'] = np.full(N, 0.3)
    values['commanded_throttle'] = np.full(N, 0.6) if drawn else np.full(N, 0.3)
    if 'side_acceleration' in drawn:
        values['disturbance'][:, 0] = 0.4 + 0.01 * k
        values['disturbance'][:, 1] = -0.2
    row = [drawn.get(name, NOMINAL.get(f'{name}_low', 0.0)) for name in DRAWN_NAMES][:width]
    outcome = np.full(N, NO_OUTCOME)
    outcome[-1] = 0
    return Samples.build(
        1000 * episode + k, np.zeros(N), np.full(N, episode), outcome,
        conditions=np.tile(row, (N, 1)), **values)


def joined(*flights: Samples) -> Samples:
    """Flights one after another."""
    layout = flights[0].layout
    return Samples(*(
        np.concatenate([getattr(one, field.name) for one in flights])
        for field in fields(Samples) if field.name != 'layout'), layout=layout)


def entities_of(path: Path) -> set[str]:
    """Entities of a recording."""
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def test_a_nominal_recording_has_nothing_of_conditions(tmp_path: Path) -> None:
    nominal, without = tmp_path / 'nominal.rrd', tmp_path / 'without.rrd'
    record(nominal, stage(), flight())
    record(without, stage(names=()), flight(width=0))
    assert entities.CONDITIONS not in entities_of(nominal)
    assert entities.DISTURBANCE not in entities_of(nominal)
    assert not rows_of(nominal, entities.ROCKET, plots.UNUSUAL)
    assert view_classes(nominal) == view_classes(without)
    assert 'TextDocument' not in view_classes(nominal)
    assert reader.trajectories(nominal)[0].summary['conditions'] == '{}'


@pytest.mark.parametrize('world', ['rocket', 'rocket_planar'])
def test_drawn_conditions_and_their_effects_are_recorded(world: str, tmp_path: Path) -> None:
    path = tmp_path / 'mix.rrd'
    samples = flight(
        thrust_factor=0.96, action_delay=2, side_acceleration=0.5, side_direction=np.pi / 3)
    record(path, stage(world), samples)
    rerun_program.verify(path)
    unusual = rows_of(path, entities.ROCKET, plots.UNUSUAL)
    assert len(unusual) == N + 1
    commanded = np.array([records[0]['commanded'] for _, records in unusual[:-1]], np.float64)
    np.testing.assert_allclose(commanded[:, 0], 60.0, rtol=1e-3)
    assert np.isnan(unusual[-1][1][0]['commanded'][0])
    engine = [records[0]['engine'] for _, records in rows_of(path, entities.ROCKET, plots.SAMPLE)]
    np.testing.assert_allclose(np.array(engine)[:-1, 0], 30.0, rtol=1e-6)
    given = samples.values[:, FIELDS['disturbance']]
    wind = np.array([records[0]['disturbance'] for _, records in unusual[:-1]], np.float64)
    np.testing.assert_allclose(wind, given[:, :2], rtol=1e-3)
    # The arrow moves with the body and points where the wind blows in the world.
    arrows = rows_of(path, entities.DISTURBANCE, 'Arrows3D:vectors')
    assert [len(vectors) for _, vectors in arrows] == [1] * N + [0]
    attitude = Rotation.from_quat(samples.values[:, FIELDS['orientation']])
    there = attitude.apply(np.array([vectors[0] for _, vectors in arrows[:-1]]))
    np.testing.assert_allclose(
        there, conditions_log.ARROW * stage().scale * given, atol=1e-4)
    (step, (text,)), = rows_of(path, entities.CONDITIONS, 'TextDocument:text')
    assert step == 0
    assert text.splitlines() == [
        '### Rocket 0, episode 0', '', '| condition | drawn | nominal |', '| --- | --- | --- |',
        '| thrust factor | 0.96 | 1 |', '| action delay | 2 steps | 0 steps |',
        f'| side acceleration | 0.5 m/s^2, {TOWARDS[world]} | 0 m/s^2 |', '',
        'All other conditions are nominal.']
    assert view_classes(path).count('TextDocument') == 1
    assert json.loads(reader.trajectories(path)[0].summary['conditions']) == {
        'thrust_factor': 0.96, 'action_delay': 2, 'side_acceleration': 0.5,
        'side_direction': np.pi / 3}


def test_nominal_flights_beside_others_record_no_conditions(tmp_path: Path) -> None:
    path = tmp_path / 'both.rrd'
    recorder = record(path, stage(), joined(
        flight(0), flight(1, throttle_floor=0.6), flight(2)))
    rerun_program.verify(path)
    assert recorder.flights == 3
    assert len(rows_of(path, entities.ROCKET, plots.SAMPLE)) == 3 * (N + 1)
    assert len(rows_of(path, entities.ROCKET, plots.UNUSUAL)) == N + 1
    (_, (text,)), = rows_of(path, entities.CONDITIONS, 'TextDocument:text')
    assert 'episode 1' in text
    assert '| throttle floor | 0.6 | 0 |' in text
    # Nothing blows.
    assert entities.DISTURBANCE not in {
        chunk.entity_path for chunk in RrdReader(path).stream() if not chunk.is_static}
    assert 'TextDocument' in view_classes(path)
    flown = [json.loads(one.summary['conditions']) for one in reader.trajectories(path)]
    assert flown == [{}, {'throttle_floor': 0.6}, {}]


def test_the_tab_survives_a_rewriting_and_can_be_in_front(tmp_path: Path) -> None:
    path, again = tmp_path / 'mix.rrd', tmp_path / 'again.rrd'
    record(path, stage(), flight(isp_factor=0.97))
    rewrite(path, again, tab='conditions')
    assert view_classes(again) == view_classes(path)
    record(tmp_path / 'nominal.rrd', stage(), flight())
    rewrite(tmp_path / 'nominal.rrd', again, tab='conditions')
    assert 'TextDocument' not in view_classes(again)


def test_every_range_that_is_not_nominal_is_detected() -> None:
    for name in RANGES:
        samples = flight(**{name: 2.0})
        assert conditions_log.unusual(samples.values, samples.layout, stage()), name
    nominal = flight(side_direction=1.0)
    assert not conditions_log.unusual(nominal.values, nominal.layout, stage())


def test_samples_with_other_conditions_than_their_world_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=(
            f"conditions: 3 values a sample, expected {len(DRAWN_NAMES)}, as world 'rocket' has")):
        record(tmp_path / 'none.rrd', stage(), flight(width=3))
    # Conditions without names are not shown.
    record(tmp_path / 'some.rrd', stage(names=()), flight(width=3))
    assert entities.CONDITIONS not in entities_of(tmp_path / 'some.rrd')
