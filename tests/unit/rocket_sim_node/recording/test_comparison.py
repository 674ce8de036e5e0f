# SPDX-License-Identifier: Apache-2.0
"""Comparisons: several pilots from equal starts, at the same time, in one small file."""
from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import pytest
import yaml
from rerun.chunk import RrdReader
from support.recording.recordings import lines_of
from support.recording.recordings import record
from support.recording.recordings import view_classes

from ppo_agent_node.commands import compare
from ppo_agent_node.commands import recorded_flights
from ppo_agent_node.commands.compare import Comparison
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds
from rocket_sim_node.recording import reader
from rocket_sim_node.recording import screenshot
from rocket_sim_node.recording import trajectory_log
from rocket_sim_node.recording.comparison import comparison
from rocket_sim_node.recording.comparison import table
from rocket_sim_node.recording.comparison.comparison import Side
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.timepoint import PAUSE
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import WIDTH
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.worlds.rocket import conditions

pytestmark = pytest.mark.slow
POLICIES = Path(recorded_flights.__file__).parents[1] / 'policies'
OUTCOMES = ('landed', 'too_fast')
STAGE = WorldInfo('rocket', 0.02, OUTCOMES)


def make_run(folder: Path, world: str, demonstrations: int, clone: bool) -> Path:
    """Make the files that a run leaves, with the shipped policy."""
    folder.mkdir()
    level = 0 if world == 'lunar_lander' else 5
    (folder / 'config.yaml').write_text(yaml.safe_dump({
        # As they come over the wire, where a switch is a number, too.
        'world': world, 'world_settings': {
            name: float(value) for name, value in worlds.make(world).spec.settings.items()},
        'training': {
            'curriculum_final_level': level, 'evaluation_seed': 20_000_000,
            'demonstration_episodes': demonstrations}}))
    shutil.copy(POLICIES / f'{world}.safetensors', folder / 'policy.safetensors')
    if clone:
        shutil.copy(POLICIES / f'{world}.safetensors', folder / 'cloned.safetensors')
    return folder


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the rocket that is taught, compared over ten starts."""
    folder = make_run(tmp_path_factory.mktemp('runs') / 'seven', 'rocket', 512, clone=True)
    (folder / 'said').write_text(compare.make(Comparison(run_dir=str(folder))))
    return folder


def test_all_pilots_fly_the_same_starts_at_the_same_time(run: Path) -> None:
    path = run / 'comparison.rrd'
    rerun_program.verify(path)
    flights = reader.trajectories(path)
    pilots = ('1_expert', '2_cloned', '3_best')
    assert [flight.pilot for flight in flights] == 10 * list(pilots)
    end = -PAUSE
    for start in range(10):
        group = flights[3 * start:3 * start + 3]
        for flight in group:
            assert flight.row == start and flight.episode == 0
            assert flight.outcome == 'landed' and flight.summary['verdict'] == 'stands'
            assert flight.start == pytest.approx(end + PAUSE, abs=0.03)
            for name in ('position', 'velocity', 'orientation'):
                np.testing.assert_array_equal(getattr(flight, name)[0], getattr(group[0], name)[0])
        assert not np.array_equal(group[0].position[400], group[1].position[400])
        # The copy of the policy flies as the policy does.
        np.testing.assert_array_equal(group[1].position, group[2].position)
        end = max(
            flight.start + 0.02 * (len(flight.time) + flight.summary['settled'] - 1)
            for flight in group)


def test_flights_are_those_of_the_evaluation(run: Path) -> None:
    """The comparison shows what `evaluate` counts: the same starts, returns, touchdowns."""
    world = worlds.make('rocket', 10, level=5)
    flown = evaluate(world, scripted_pilot(world.spec), 10, 20_000_000).episodes
    shown = [f for f in reader.trajectories(run / 'comparison.rrd') if f.pilot == '1_expert']
    assert len(shown) == 10
    for number, flight in enumerate(shown):
        assert flight.summary['return'] == pytest.approx(flown.episode_return[number], abs=1e-9)
        assert flight.summary['speed'] == pytest.approx(flown.touchdown_speed[number], abs=1e-9)
        assert len(flight.time) == flown.length[number] + 1
        assert flight.fuel[0] - flight.fuel[-1] == pytest.approx(
            flown.fuel_used[number], abs=1e-3)


@pytest.mark.parametrize('drawn', ['', 'hoverslam'])
def test_the_vehicles_are_those_of_the_run(tmp_path: Path, drawn: str) -> None:
    """Also where the agent, not the simulator, sets the conditions."""
    folder = make_run(tmp_path / 'run', 'rocket', 512, clone=False)
    config = yaml.safe_load((folder / 'config.yaml').read_text())
    config['training']['conditions'] = drawn
    (folder / 'config.yaml').write_text(yaml.safe_dump(config))
    flown = recorded_flights.read_run(folder)
    world = recorded_flights.make_world(flown, 1, 7)
    assert conditions.name_of(world.spec.settings) == (drawn or 'nominal')
    expert = recorded_flights.pilots(flown, world)[0][0][3]
    assert expert.name == (drawn or 'expert')


def test_size_and_layout(run: Path) -> None:
    path = run / 'comparison.rrd'
    flights = reader.trajectories(path)
    steps = sum(len(flight.time) + flight.summary['settled'] for flight in flights)
    assert f'({steps} steps,' in (run / 'said').read_text()
    assert path.stat().st_size <= 150 * 1024 * steps / 1000
    kinds = view_classes(path)
    assert kinds.count('3D') == 3
    assert kinds.count('TimeSeries') == 5
    assert {'TextDocument', 'TextLog', 'StateTimeline'} <= set(kinds)
    logged = {chunk.entity_path for chunk in RrdReader(path).stream()}
    for pilot in ('1_expert', '2_cloned', '3_best'):
        assert f'/{pilot}{entities.BODY}' in logged
    assert not any(entity.startswith('/world') for entity in logged)
    assert [item.name for item in run.glob('.*')] == [], 'nothing is left behind'


def test_the_plots_hold_the_flights(run: Path) -> None:
    path = run / 'comparison.rrd'
    flight = reader.trajectories(path)[1]
    assert flight.pilot == '2_cloned'
    for name, expected in (
        ('height', flight.position[:, 2] - 5.2),
        ('speed', np.linalg.norm(flight.velocity, axis=1)),
        ('fuel_used', flight.fuel[0] - flight.fuel),
    ):
        rows = lines_of(path, f'/2_cloned{entities.ROCKET}', name)[:len(expected)]
        np.testing.assert_allclose(
            [value[0] for _, value in rows], expected, atol=2e-3, err_msg=name)


@pytest.mark.parametrize('known', ['start_fuel', 'conditions', 'none'])
def test_the_fuel_of_a_comparison_is_that_of_its_vehicles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known: str,
) -> None:
    """Older files lack the fuel at the start, and have the drawn factor at most."""
    stage = replace(STAGE, condition_names=('fuel_factor',))
    flight = fall(2.0)
    layout = Layout(conditions=1)
    values = np.concatenate((flight.values, np.full((len(flight), 1), 0.9)), axis=1)
    values[:, FIELDS['fuel']] = 1_800.0 - np.arange(len(flight))[:, None]
    flight = replace(flight, values=values, layout=layout)
    path = tmp_path / 'a.rrd'
    summary = trajectory_log._summary

    def older(*what: Any) -> Any:
        record, = summary(*what).to_pylist()
        if known != 'start_fuel':
            del record['start_fuel']
        if known == 'none':
            del record['conditions']
        return pa.array([record])

    monkeypatch.setattr(trajectory_log, '_summary', older)
    comparison.write(
        path, [Side('a', 'a', 'A', (flight,))], stage, lambda flights, info: [None])
    found, = reader.trajectories(path)
    tank = 2_000.0 if known == 'none' else 1_800.0
    np.testing.assert_allclose(found.fuel, tank - np.arange(len(flight)), atol=1e-2)


def test_results_are_printed_and_recorded(run: Path) -> None:
    said = (run / 'said').read_text()
    assert 'Run **seven**, world **rocket, level 5**: 10 equal starts, seed 20000000.' in said
    shown = [f for f in reader.trajectories(run / 'comparison.rrd') if f.pilot == '1_expert']
    row = next(line for line in said.splitlines() if line.startswith('| expert |'))
    cells = [cell.strip() for cell in row.strip('|').split('|')]
    assert cells[1:3] == ['10 of 10', '10']
    means = [np.mean([f.summary[name] for f in shown]) for name in (
        'return', 'speed', 'tilt', 'distance', 'fuel_used')]
    assert cells[3:8] == [
        f'{means[0]:.1f}', f'{means[1]:.3f}', f'{means[2]:.2f}', f'{means[3]:.2f}',
        f'{means[4]:.0f}']
    document, = (
        chunk.to_record_batch().column('TextDocument:text').to_pylist()[0][0]
        for chunk in RrdReader(run / 'comparison.rrd').stream() if chunk.entity_path == '/results')
    assert said.startswith(document)


def test_a_run_without_demonstrations_is_compared_without_a_clone(tmp_path: Path) -> None:
    run = make_run(tmp_path / 'moon', 'lunar_lander', 0, clone=False)
    said = compare.make(Comparison(run_dir=str(run), episodes=2, output=str(tmp_path / 'a.rrd')))
    assert 'without demonstrations: there is no clone' in said
    flights = reader.trajectories(tmp_path / 'a.rrd')
    assert [f.pilot for f in flights] == 2 * ['1_heuristic', '2_trained']
    assert view_classes(tmp_path / 'a.rrd').count('2D') == 2
    total = flights[0].reward.sum()
    assert total == pytest.approx(flights[0].summary['return'], abs=1e-2)


def test_an_older_run_is_compared_without_its_clone(tmp_path: Path) -> None:
    run = make_run(tmp_path / 'old', 'rocket_planar', 512, clone=False)
    said = compare.make(Comparison(run_dir=str(run), episodes=1, level=2, seed=4))
    assert 'the version that made it kept no clone' in said
    assert 'level 2**: one start, seed 4' in said
    assert [f.pilot for f in reader.trajectories(run / 'comparison.rrd')] == [
        '1_expert', '2_best']
    row = next(line for line in said.splitlines() if line.startswith('| expert |'))
    # It ends at rest; what counts is the speed at which the feet met the ground.
    assert 0.001 < float(row.split('|')[4]) < 0.2


def fall(speed: float, outcome: str = 'landed', contact: int = 0) -> Trajectory:
    """Return eleven samples of a fall at a constant speed; the last touch when asked."""
    values = np.zeros((11, WIDTH))
    values[:, FIELDS['position']] = np.stack(
        (np.zeros(11), np.zeros(11), 20.0 - 0.02 * speed * np.arange(11)), axis=1)
    values[:, FIELDS['orientation']] = (0.0, 0.0, 0.0, 1.0)
    values[:, FIELDS['linear_velocity']] = (0.0, 0.0, -3.0)
    if contact:
        values[contact:, FIELDS['contact_force']] = (0.0, 0.0, 1.0)
        values[contact:, FIELDS['linear_velocity']] = 0.0
    return Trajectory(0, 0, 0, outcome, values)


def test_touchdown_speed() -> None:
    assert table.touchdown_speed(fall(2.0)) == 3.0
    assert table.touchdown_speed(fall(2.0, contact=5)) == 3.0
    assert table.touchdown_speed(fall(2.0, contact=1)) == 3.0


def test_touchdowns_are_averaged_over_those_that_landed() -> None:
    """A crash has a return, but its speed is none of a landing."""
    crash = fall(2.0, outcome='too_fast')
    crash.values[-1, FIELDS['linear_velocity']] = (0.0, 0.0, -90.0)
    some, none = Side('a', 'some', 'A', (fall(2.0), crash)), Side('b', 'none', 'B', (crash, crash))
    text = table.results([some, none], [('', ''), ('', '')], STAGE)
    rows = {cells[1].strip(): [cell.strip() for cell in cells[2:]] for cells in (
        line.split('|') for line in text.splitlines() if line.count('|') > 3)}
    assert rows['some'][0] == '1 of 2' and rows['some'][2] == '3.000'
    assert rows['none'][0] == '0 of 2' and rows['none'][2:5] == ['–', '–', '–']
    assert 'means of those that landed' in text


def test_the_end_is_that_of_the_recording() -> None:
    """It is not that of the last pilot by name, nor that of the selected flight."""
    flights = [SimpleNamespace(start=start, time=np.array((0.0, long)), outcome='landed',
                               summary={'settled': 0, 'dt': 0.02})
               for start, long in ((0.0, 5.0), (9.0, 8.0), (9.0, 6.0))]
    for flight in (-1, 0, 1):
        picture = screenshot.ScreenshotSettings('a.rrd', at='end', flight=flight)
        assert screenshot.moment(picture, flights) == 18.0  # type: ignore[arg-type]
    flights[2].summary['settled'] = 250
    assert screenshot.moment(picture, flights) == 21.0  # type: ignore[arg-type]


@pytest.mark.parametrize('at', ['nan', 'inf', '-inf', 'soon'])
def test_a_moment_is_a_number(at: str) -> None:
    with pytest.raises(ValueError, match=f"at: got '{at}', expected burn, touchdown, end or"):
        screenshot.moment(screenshot.ScreenshotSettings('a.rrd', at=at), [])


@pytest.mark.parametrize(('sides', 'complaint'), [
    ([], 'no flights'),
    ([Side('a', 'a', 'A', ())], 'no flights'),
    ([Side('a', 'a', 'A', (fall(1.0),)), Side('a', 'b', 'B', (fall(1.0),))], 'each once'),
    ([Side('a', 'a', 'A', (fall(1.0),)), Side('b', 'b', 'B', (fall(1.0), fall(1.0)))],
     'b flew 2 flights, expected 1 as a did'),
    ([Side('a', 'a', 'A', (fall(1.0),)), Side('b', 'b', 'B', (
        replace(fall(1.0), values=fall(1.0).values + 1.0),))],
     'flight 1 of b began at another position than that of a'),
])
def test_flights_that_cannot_be_compared_are_refused(
    tmp_path: Path, sides: list[Side], complaint: str,
) -> None:
    with pytest.raises(ValueError, match=complaint):
        comparison.write(tmp_path / 'a.rrd', sides, STAGE, touchdown.follow)
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope='module')
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs that cannot be compared, or not in every way."""
    folder = tmp_path_factory.mktemp('others')
    young = make_run(folder / 'young', 'rocket', 512, clone=False)
    (young / 'policy.safetensors').unlink()
    config = yaml.safe_load((young / 'config.yaml').read_text())
    for name, values in (
            ('bad', {'world': 'rocket'}), ('empty', {**config, 'world_settings': None})):
        (folder / name).mkdir()
        (folder / name / 'config.yaml').write_text(yaml.safe_dump(values))
    return {
        'MOON': make_run(folder / 'moon', 'lunar_lander', 0, clone=False), 'YOUNG': young,
        'BAD': folder / 'bad', 'EMPTY': folder / 'empty'}


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['episodes:=3'], 'run_dir: got none'),
    (['run_dir:=/nowhere'], 'not the folder of a run'),
    (['run_dir:=RUN', 'output:=a.txt'], "output: got 'a.txt', expected a name that ends with"),
    (['run_dir:=RUN', 'episodes:=0'], 'episodes: got 0, expected 1 to 100'),
    (['run_dir:=RUN', 'starts:=3'], "unknown setting 'starts'"),
    (['run_dir:=RUN', 'output:=/proc/a.rrd', 'episodes:=1'], 'could not write'),
    (['run_dir:=MOON', 'level:=3'], 'level: got 3, expected 0, as world lunar_lander has no'),
    (['run_dir:=BAD'], 'config.yaml: damaged'),
    (['run_dir:=EMPTY'], 'config.yaml: damaged'),
    (['run_dir:=YOUNG'], 'no policy yet'),
])
def test_bad_arguments_are_named(
    run: Path, others: dict[str, Path], arguments: list[str], complaint: str,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    for name, folder in {'RUN': run, **others}.items():
        arguments = [argument.replace(name, str(folder)) for argument in arguments]
    monkeypatch.setattr(sys, 'argv', ['compare', *arguments])
    with pytest.raises(SystemExit) as end:
        compare.main()
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert complaint in said and said.startswith('compare: ') and said.count('\n') == 1


def test_a_comparison_has_no_other_tabs(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, 'argv', [
        'screenshot', f'recording:={run / "comparison.rrd"}', 'tab:=training'])
    with pytest.raises(SystemExit):
        screenshot.main()
    assert "tab: got 'training', expected flight" in capsys.readouterr().err


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['tab:=training'], "tab: got 'training', expected flight, log, as"),
    (['tab:=conditions'], "tab: got 'conditions', expected flight, log, as"),
    (['output:=picture'], "output: got 'picture', expected a name that ends with .png")])
def test_what_a_screenshot_cannot_show_is_refused_before_it_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    arguments: list[str], complaint: str,
) -> None:
    world = worlds.make('rocket', 1)
    samples = recorded_flights.fly(world, scripted_pilot(world.spec), 3)
    record(tmp_path / 'a.rrd', WorldInfo.of(world.spec), samples)
    monkeypatch.setattr(screenshot, 'render', lambda *what, **how: pytest.fail('drawn'))
    monkeypatch.setattr(
        sys, 'argv', ['screenshot', f'recording:={tmp_path / "a.rrd"}', *arguments])
    with pytest.raises(SystemExit) as end:
        screenshot.main()
    said = capsys.readouterr().err
    assert end.value.code == 2
    assert complaint in said and said.count('\n') == 1


def test_two_worlds_in_one_file_are_read(tmp_path: Path) -> None:
    """A recorder outlives its simulator; the next one may serve another world."""
    parts: list[Any] = []
    for name in ('rocket', 'lunar_lander'):
        world = worlds.make(name, 1)
        samples = recorded_flights.fly(world, scripted_pilot(world.spec), 3)
        spec = world.spec
        parts.append(SimpleNamespace(
            samples=samples, end=recorded_flights.flights(samples, spec.outcomes)[0],
            stage=WorldInfo.build(name, spec.dt, spec.outcomes, spec.settings)))
    path = tmp_path / 'both.rrd'
    record(path, parts[0].stage, parts[0].samples, more=[(parts[1].stage, parts[1].samples)])
    rocket, lander = reader.trajectories(path)
    for flight, part in ((rocket, parts[0]), (lander, parts[1])):
        np.testing.assert_allclose(flight.position, part.end.position, atol=1e-4)
        np.testing.assert_allclose(flight.velocity, part.end.linear_velocity, atol=1e-3)
        np.testing.assert_allclose(flight.throttle, part.end.throttle, atol=1e-6)
    np.testing.assert_allclose(rocket.fuel, parts[0].end.fuel, atol=1e-2)


def test_the_command_prints_its_usage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, 'argv', ['compare', '--help'])
    compare.main()
    said = capsys.readouterr().out
    assert 'Usage: compare run_dir:=DIR' in said and 'episodes' in said
