# SPDX-License-Identifier: Apache-2.0
"""Training with simulator and agent as separate processes, and the files that it leaves."""
from __future__ import annotations

import json
import signal
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.invalid_data.forger import KINDS
from support.processes import Processes
from support.training.training_runs import SMALL
from support.training.training_runs import agent
from support.training.training_runs import assert_same_run
from support.training.training_runs import evaluate_in_process
from support.training.training_runs import fresh_agent
from support.training.training_runs import log_without_times
from support.training.training_runs import simulator
from support.training.training_runs import train_in_process

from rocket_sim_node.wire.client.client import Client

RESULTS = (
    'config.yaml', 'train.jsonl', 'policy.safetensors', 'evaluation.json',
    'checkpoints/best.safetensors',
)


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run in one process, without ROS."""
    return train_in_process(tmp_path_factory.mktemp('undisturbed') / 'run')


@pytest.mark.smoke
def test_training_over_dds_equals_training_in_process(
        processes: Processes, tmp_path: Path, undisturbed: Path) -> None:
    recording = tmp_path / 'recording.rrd'
    run = tmp_path / 'run'
    recorder = processes.run_node('rocket_sim_node', 'rerun_recorder', output=recording)
    # The agent first: any order of start will do.
    trainer = agent(processes, run, plots=True)
    simulator(processes)
    assert trainer.wait(120.0) == 0, processes.logs()
    assert_same_run(run, undisturbed)

    for name in RESULTS:
        assert (run / name).stat().st_size > 0, name
    assert len(list((run / 'plots').glob('*.png'))) >= 3
    settings = yaml.safe_load((run / 'config.yaml').read_text())
    assert settings['training']['seed'] == SMALL['seed']
    assert settings['world_settings']['max_thrust'] == 470_880.0
    evaluation = json.loads((run / 'evaluation.json').read_text())
    assert evaluation['episodes'] == sum(evaluation['outcomes'].values()) == 20
    stages = [line['stage'] for line in log_without_times(run)]
    # Two waves on either level; an epoch before the round of DAgger and two after it.
    assert stages == ['demonstrate'] * 4 + ['clone'] * 3 + ['finetune'] * 5

    recorder.signal(signal.SIGINT)
    assert recorder.wait(20.0) == 0, processes.logs()
    check = processes.start('rerun', 'rrd', 'verify', str(recording))
    assert check.wait(30.0) == 0, check.output()
    from rocket_sim_node.recording.reader import trajectories
    flights = trajectories(recording)
    assert flights
    assert all(np.isfinite(flight.position).all() for flight in flights)
    # Fallen from 200 m to the ground, or out of its limits: never a flight of one sample.
    assert max(len(flight.time) for flight in flights) > 100


@pytest.mark.skipif(
    int(version('rclpy').split('.')[0]) < 9, reason="Jazzy's rclpy tells no writer")
def test_training_among_forgeries_equals_training_in_process(
        processes: Processes, tmp_path: Path, undisturbed: Path) -> None:
    """Forged answers arrive first; dropped messages are counted in each file and reported."""
    run = tmp_path / 'run'
    node = simulator(processes)
    processes.start(
        'python', '-m', 'support.invalid_data.forger', '--ros-args',
        '-p', f'kinds:={",".join(KINDS)}', '-p', 'every:=10').wait_for('forging', 30.0)
    # Not forked: it discovers who publishes what during its imports, as a user's agent does.
    trainer = fresh_agent(processes, run)
    assert trainer.wait(240.0) == 0, processes.logs()
    lines = [json.loads(line) for line in (run / 'train.jsonl').read_text().splitlines()]
    assert sum(line['messages_dropped'] for line in lines) > 0
    assert_same_run(run, undisturbed, but=('messages_dropped',))
    found, expected = (
        json.loads((folder / 'evaluation.json').read_text())
        for folder in (run, evaluate_in_process(undisturbed)))
    assert found.pop('messages_dropped') > 0
    assert expected.pop('messages_dropped') == 0
    assert found == expected
    for process in (node, trainer):
        assert 'ERROR' in process.output()
        assert '/forger (GID ' in process.output()


def test_expert_pilot_lands(processes: Processes) -> None:
    simulator(processes)
    pilot = processes.run_node('ppo_agent_node', 'expert_pilot', episodes=24, level=3)
    assert pilot.wait(60.0) == 0, processes.logs()
    assert 'landed 24' in pilot.output() or 'landed 25' in pilot.output(), pilot.output()


def test_damaged_config_is_refused(processes: Processes, tmp_path: Path) -> None:
    run = tmp_path / 'run'
    run.mkdir()
    (run / 'config.yaml').write_text('training: 5\n')
    node = agent(processes, run, resume=True)
    assert node.wait(30.0) == 2, node.output()
    assert f'{run}/config.yaml: training is 5' in node.output()


def test_damaged_policy_is_refused(processes: Processes, tmp_path: Path) -> None:
    simulator(processes)
    for name, content in (('empty', b''), ('noise', bytes(range(256)) * 8)):
        path = tmp_path / f'{name}.safetensors'
        path.write_bytes(content)
        node = processes.fork_node('ppo_agent_node', 'ppo_agent', mode='infer', policy=path)
        assert node.wait(30.0) == 2, node.output()
        assert str(path) in node.output()
        assert 'Traceback' not in node.output()


def test_two_agents_at_one_simulator(
        processes: Processes, make_client: Callable[..., Client], tmp_path: Path) -> None:
    processes.run_node('rocket_sim_node', 'simulator', num_envs=8, agent_lease=600.0)
    first = make_client()
    first.reset(1)
    second = agent(processes, tmp_path / 'run', patience=2.0)
    assert second.wait(60.0) == 2, processes.logs()
    assert 'controls this simulator' in second.output()
    first.step(np.zeros((8, 3), np.float32))  # as before


def test_two_agents_in_one_run_folder(processes: Processes, tmp_path: Path) -> None:
    simulator(processes)
    run = tmp_path / 'run'
    first = agent(processes, run, iterations=2000, resume=True)
    first.wait_for('PPO 1/', 90.0)
    assert f'{run} holds no run to resume: a new one begins' in first.output()
    assert 'num_envs is 8; preset default of rocket was made with 256' in first.output()
    assert 'start_copies is 8, not 16, which does not divide num_envs' in first.output()
    first.signal(signal.SIGSTOP)  # it trains here all the same
    second = agent(processes, run, iterations=2000, resume=True)
    assert second.wait(30.0) == 2, processes.logs()
    assert 'holds no run' not in second.output()
    assert 'another process is training here' in second.output()
    assert first.running
    assert agent(processes, run).wait(30.0) == 2, processes.logs()
    first.signal(signal.SIGKILL)  # stopped, it cannot end by itself


def test_simulators_that_join_and_leave_do_not_change_the_result(
        processes: Processes, tmp_path: Path) -> None:
    # Without copies: both kinds of roll-outs are compared in this file.
    groups = {'num_groups': 3, 'start_copies': 1}
    run = tmp_path / 'run'
    first, second = (simulator(processes, namespace=f'/sim_{k}') for k in range(2))
    trainer = agent(processes, run, simulators='/sim_*', **groups)
    trainer.wait_for('PPO 1/', 90.0)
    first.signal(signal.SIGKILL)
    simulator(processes, namespace='/sim_2')
    trainer.wait_for('PPO 2/', 30.0)
    second.signal(signal.SIGTERM)
    assert trainer.wait(120.0) == 0, processes.logs()
    reference = tmp_path / 'reference'
    reference.mkdir()
    assert_same_run(run, train_in_process(reference / 'run', **groups))
