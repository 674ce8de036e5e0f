# SPDX-License-Identifier: Apache-2.0
"""The commands of launch_scripts/ as a user types them."""
from __future__ import annotations

import json
import os
import pwd
import re
import shlex
import signal
import subprocess
from pathlib import Path

import psutil
import pytest
import yaml
from support.processes import Process
from support.processes import Processes
from support.training import training_runs

from rocket_sim_node.recording.reader import trajectories

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
SMALL = (
    'num_envs:=8', 'demonstration_episodes:=8', 'dagger_rounds:=1', 'dagger_epochs:=1',
    'clone_epochs:=2', 'hidden_sizes:=[16,16]',
    'iterations:=2', 'n_steps:=64', 'batch_size:=256', 'selection_interval:=2',
    'selection_episodes:=8', 'evaluation_episodes:=8', 'critic_warmup_iterations:=1',
    'threads:=1', 'plots:=false',
)
"""Settings of a run that takes seconds."""
LOW = (
    'curriculum_start_level:=3', 'curriculum_final_level:=3', 'curriculum_wide_level:=4',
    *(f'{name}:={value:g}' for name, value in training_runs.LOW.items()),
)
"""Settings of its flights, which take 4 s; under nominal conditions the expert lands."""


def command(processes: Processes, name: str, *arguments: str) -> Process:
    """Start one of the scripts."""
    return processes.start(str(SCRIPTS / name), *arguments)


def test_a_run_in_an_awkward_folder_is_resumed_in_its_conditions(
        processes: Processes, tmp_path: Path) -> None:
    run, flights = tmp_path / 'a run #1', tmp_path / 'flights.rrd'
    # Without demonstrations: under `mix`, none lands from the low start.
    settings = [one for one in SMALL if not one.startswith('demonstration_episodes')]
    first = command(
        processes, 'train', f'run_dir:={run}', 'conditions:=mix', 'observation:=extended',
        'max_thrust:=500000', 'demonstration_episodes:=0', 'second_simulator:=', *settings, *LOW)
    assert first.wait(120.0) == 0, processes.logs()
    assert first.output().splitlines()[-1] == f'run: {run}'
    for name in ('config.yaml', 'train.jsonl', 'policy.safetensors', 'evaluation.json'):
        assert (run / name).is_file(), name
    assert (run / 'recording.rrd').is_file()
    assert not (run / 'plots').exists()
    assert not (run / 'report.html').exists()
    assert len((run / 'train.jsonl').read_text().splitlines()) == 3
    config = yaml.safe_load((run / 'config.yaml').read_text())
    assert (config['conditions'], config['observation']) == ('mix', 'extended')
    assert config['training']['conditions'] == 'mix'
    assert config['world_settings']['engine_lag_high'] == 0.2
    assert config['world_settings']['max_thrust'] == 500_000.0
    # The size of the batch, the conditions and all settings come from the run.
    again = command(processes, 'train', f'run_dir:={run}', 'resume:=true', 'second_simulator:=')
    assert again.wait(120.0) == 0, processes.logs()
    assert len((run / 'train.jsonl').read_text().splitlines()) == 3
    # Refused, it is as finished as before: `land` flies its policy.
    refused = command(processes, 'train', f'run_dir:={run}', 'resume:=true', 'gamma:=0.5')
    assert refused.wait(60.0) == 2
    assert 'gamma of the run is' in refused.output()
    assert f'train: the run was not resumed and is unchanged: {run}' in refused.output()
    assert 'continue with' not in refused.output(), 'that has just failed'
    assert 'Traceback' not in refused.output()
    assert not (run / '.unfinished').exists()
    landed = command(
        processes, 'land', f'policy:={run / "policy.safetensors"}', 'conditions:=mix',
        'observation:=extended', 'episodes:=4', f'output:={flights}')
    assert landed.wait(90.0) == 0, processes.logs()
    flown = trajectories(flights)
    assert len(flown) == 4
    drawn = [json.loads(flight.summary['conditions']) for flight in flown]
    assert len({each['thrust_factor'] for each in drawn}) == 4
    assert all(0.95 <= each['thrust_factor'] <= 1.05 for each in drawn)


def test_conditions_that_do_not_exist_are_named(processes: Processes, tmp_path: Path) -> None:
    named = command(processes, 'land', 'conditions:=storm', f'output:={tmp_path / "no.rrd"}')
    assert named.wait(60.0) != 0
    assert "conditions: got 'storm', expected one of nominal, mix" in processes.logs()


def test_the_vehicle_of_a_run_is_not_replaced(processes: Processes, tmp_path: Path) -> None:
    run, other = tmp_path / 'run', tmp_path / 'other.yaml'
    run.mkdir()
    (run / 'config.yaml').write_text('world: rocket\n')
    (run / 'simulator.yaml').write_text('the vehicle of the run')
    other.write_text('/**:\n  ros__parameters:\n    dry_mass: 20000.0\n')
    refused = command(processes, 'train', f'run_dir:={run}', f'simulator_parameters:={other}')
    assert refused.wait(30.0) == 2
    assert 'already holds a run' in refused.output()
    assert (run / 'simulator.yaml').read_text() == 'the vehicle of the run'
    # Nor is anything left of a start that is refused later.
    new = tmp_path / 'new'
    refused = command(
        processes, 'train', f'run_dir:={new}', f'simulator_parameters:={other}', 'clip_rang:=0.2')
    assert refused.wait(30.0) == 2
    assert "unknown argument 'clip_rang', did you mean 'clip_range'?" in refused.output()
    assert not new.exists()


@pytest.mark.smoke
def test_land_flies_the_policy_that_ships(processes: Processes, tmp_path: Path) -> None:
    recording = tmp_path / "a pilot's landing.rrd"
    land = command(
        processes, 'land', 'episodes:=8', f'output:={recording}',
        f'policy:={SCRIPTS.parent}/ppo_agent_node/ppo_agent_node/policies/rocket.safetensors')
    assert land.wait(90.0) == 0, processes.logs()
    assert 'landed 8' in land.output(), land.output()
    assert recording.is_file()
    shown, = re.findall('watch it with: (.*)', land.output())
    assert shlex.split(shown)[1:] == [str(recording)], 'quoted for a shell'
    again = command(processes, 'land', f'output:={recording}')
    assert again.wait(30.0) == 2
    refused = command(processes, 'land', 'policy:=lunar_lander', f'output:={tmp_path}/none.rrd')
    # A full ROS 2 does not pass the node's status on.
    assert refused.wait(60.0) == (2 if 'HOVERSLAM_WHEELS' in os.environ else 1)
    assert 'Traceback' not in refused.output()
    assert list(tmp_path.glob('*.rrd')) == [recording], 'no recording of 0 flights'
    assert 'already exists' in again.output()


def test_a_refused_recorder_ends_a_launch_of_land(processes: Processes, tmp_path: Path) -> None:
    land = processes.start(
        'ros2', 'launch', 'ppo_agent_node', 'land.launch.yaml', f'output:={tmp_path}/landing.rrd',
        'connect:=nonsense', 'policy:=default', 'episodes:=0')
    assert land.wait(60.0) != 0, 'it would fly for ever'
    assert "connect: got 'nonsense'" in land.output()
    assert not list(tmp_path.glob('*.rrd'))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_land_passes_a_signal_on_to_its_nodes(
        processes: Processes, request: pytest.FixtureRequest, tmp_path: Path,
        number: signal.Signals) -> None:
    """`kill PID` and supervisors send a signal to the script alone."""
    if number == signal.SIGINT:
        request.getfixturevalue('nightly_only')
    land = command(processes, 'land', 'episodes:=0', f'output:={tmp_path}/landing.rrd')
    land.wait_for('episodes:', 60.0)
    nodes = psutil.Process(land.pid).children(recursive=True)
    os.kill(land.pid, number)
    ended = land.wait(45.0)
    if number == signal.SIGINT:
        assert ended == 0, processes.logs()
    assert psutil.wait_procs(nodes, timeout=5.0)[1] == []
    assert (tmp_path / 'landing.rrd').is_file()


def test_evaluate_the_expert(processes: Processes, tmp_path: Path) -> None:
    run = command(
        processes, 'evaluate', 'pilot:=expert', 'episodes:=64', 'num_envs:=64',
        f'output:={tmp_path / "figures"}')
    assert run.wait(60.0) == 0, processes.logs()
    figures = json.loads((tmp_path / 'figures' / 'evaluation.json').read_text())
    assert figures['landing_rate'] == 1.0
    assert figures['level'] == 7
    assert figures['mean_return'] > 294.0


def test_train_evaluate_and_land_in_a_world_without_levels(
        processes: Processes, tmp_path: Path) -> None:
    run = tmp_path / 'run'
    training = command(
        processes, 'train', 'world:=lunar_lander', 'preset:=original', f'run_dir:={run}',
        'record:=false', 'second_simulator:=', 'n_steps:=60', 'hidden_sizes:=[16]',
        'training_episodes:=10', 'selection_episodes:=8', 'evaluation_episodes:=8', 'threads:=1')
    assert training.wait(90.0) == 0, processes.logs()
    assert re.search(r'episode: 1/10, score: -?\d+\.\d, average: -?\d+\.\d\n', training.output())
    settings = yaml.safe_load((run / 'config.yaml').read_text())
    assert (settings['world'], settings['num_envs']) == ('lunar_lander', 8)
    assert settings['training']['activation'] == 'relu'
    assert (run / 'plots' / 'score.png').is_file()
    evaluation = command(
        processes, 'evaluate', 'world:=lunar_lander', f'policy:={run}/policy.safetensors',
        'episodes:=8', 'num_envs:=8', f'output:={tmp_path}/figures', 'plots:=false')
    assert evaluation.wait(60.0) == 0, processes.logs()
    assert {path.name for path in (tmp_path / 'figures').iterdir()} == {
        'evaluation.json', 'episodes.csv'}
    figures = json.loads((tmp_path / 'figures' / 'evaluation.json').read_text())
    assert (figures['world'], figures['level'], figures['fuel_ratio']) == (
        'lunar_lander', None, None)
    land = command(
        processes, 'land', 'world:=lunar_lander', f'policy:={run}/policy.safetensors',
        'episodes:=4', f'output:={tmp_path}/landing.rrd')
    assert land.wait(60.0) == 0, processes.logs()
    assert re.search(r'\d episodes: .*mean return', land.output()), land.output()


def test_the_random_pilot_flies_any_world(processes: Processes) -> None:
    listed = processes.start('ros2', 'pkg', 'executables', 'ppo_agent_node')
    assert listed.wait(30.0) == 0
    assert listed.output().split()[1::2] == [
        'action_server', 'evaluate', 'expert_pilot', 'keyboard_pilot', 'ppo_agent',
        'random_pilot', 'watch']
    for world in ('rocket', 'lunar_lander'):
        simulator = processes.run_node('rocket_sim_node', 'simulator', world=world, num_envs=8)
        pilot = processes.run_node('ppo_agent_node', 'random_pilot', episodes=16, seed=3)
        assert pilot.wait(60.0) == 0, processes.logs()
        assert re.search(r'1[6-9] episodes: .*mean return -\d', pilot.output()), pilot.output()
        simulator.end()


def test_the_pilot_of_the_tutorial_flies_and_lands(processes: Processes, tmp_path: Path) -> None:
    text = (SCRIPTS.parent / 'docs' / 'tutorials' / 'own-pilot.md').read_text()
    (snippet,) = re.findall(r'```python\n(.*?run_pilot\(.*?)```', text, re.DOTALL)
    (tmp_path / 'my_pilot.py').write_text(snippet)
    processes.run_node('rocket_sim_node', 'simulator', num_envs=16)
    pilot = processes.start(
        'python', str(tmp_path / 'my_pilot.py'), '--ros-args', '-p', 'episodes:=16',
        '-p', 'level:=1')
    assert pilot.wait(60.0) == 0, processes.logs()
    assert re.search(r'(1[6-9]) episodes: landed \1;', pilot.output()), pilot.output()


@pytest.mark.parametrize(('name', 'argument', 'words'), [
    ('train', 'seed=3', "got 'seed=3', expected NAME:=VALUE"),
    ('land', 'simulator_parameters:=/dev/zero', 'got a device, expected a regular file'),
    ('evaluate', 'speed:=3', "unknown argument 'speed'"),
])
def test_bad_arguments_are_named(
        processes: Processes, name: str, argument: str, words: str) -> None:
    run = command(processes, name, argument)
    assert run.wait(30.0) == 2
    assert words in run.output()
    assert len(run.output().splitlines()) == 1


@pytest.mark.parametrize('words', [
    [str(SCRIPTS / 'land')], ['ros2', 'run', 'rocket_sim_node', 'simulator']])
def test_a_domain_that_is_not_a_number_is_named(
        processes: Processes, monkeypatch: pytest.MonkeyPatch, words: list[str]) -> None:
    monkeypatch.setattr(processes, 'domain', 'abc')
    run = processes.start(*words)
    assert run.wait(30.0) == 2
    assert "ROS_DOMAIN_ID: got 'abc', expected a whole number" in run.output()
    assert len(run.output().splitlines()) == 1


def test_the_home_of_a_user_without_home_is_found() -> None:
    env = {name: value for name, value in os.environ.items() if name != 'HOME'}
    done = subprocess.run(
        ['bash', '-c', f'. {SCRIPTS}/env.sh && echo "$HOME"'], env=env, capture_output=True,
        text=True, check=True, timeout=60)
    assert done.stdout.strip() == pwd.getpwuid(os.getuid()).pw_dir


@pytest.mark.parametrize('name', ['report', 'compare', 'failures', 'screenshot', 'secure'])
def test_without_arguments_the_usage_is_the_error(processes: Processes, name: str) -> None:
    run = command(processes, name)
    assert run.wait(30.0) == 2
    assert run.output().startswith('Usage: ')
