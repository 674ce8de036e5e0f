# SPDX-License-Identifier: Apache-2.0
"""Two agents train one run over DDS, each with a simulator of its own."""
from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest
from support.processes import Process
from support.processes import Processes
from support.training.rank_program import free_port
from support.training.rank_program import train
from support.training.rank_program import variables
from support.training.training_runs import LOW
from support.training.training_runs import SMALL
from support.training.training_runs import assert_same_run
from support.training.training_runs import simulator

from ppo_agent_node.config.presets import load_preset

SHORT = {**SMALL, 'iterations': 2, 'num_groups': 2}


def agents(processes: Processes, run: Path, **parameters: object) -> list[Process]:
    """Start both ranks of a run; rank 1 names a folder and loggers that it does not use."""
    port = free_port()
    return [processes.fork_node(
        'ppo_agent_node', 'ppo_agent', (f'__ns:=/rank_{rank}',), variables(rank, 2, port),
        **{**SHORT, **parameters, **(
            {'run_dir': run.with_name('run_1'), 'loggers': 'missing.py:Logger'} if rank else
            {'run_dir': run})})
        for rank in range(2)]


def test_two_agents_train_as_two_processes_without_ros_do(
        processes: Processes, tmp_path: Path) -> None:
    run, other = tmp_path / 'run', tmp_path / 'other'
    for rank in range(2):
        simulator(processes, namespace=f'/rank_{rank}')
    first, second = agents(processes, run)
    for process in (first, second):
        assert process.wait(120.0) == 0, processes.logs()
    assert 'best policy so far' in second.output()
    assert 'saved policy.safetensors' not in second.output()
    assert (run / 'evaluation.json').exists()
    assert not (tmp_path / 'run_1').exists()

    values = {**SHORT, 'hidden_sizes': json.loads(str(SHORT['hidden_sizes']))}
    for text in train(other, 2, load_preset('default', 'rocket', **values).flat(), low=LOW):
        assert text.endswith('finished\n'), text
    assert_same_run(run, other)


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGINT])
def test_an_agent_that_loses_the_other_prints_how_to_resume(
        processes: Processes, tmp_path: Path, number: signal.Signals) -> None:
    run = tmp_path / 'run'
    for rank in range(2):
        simulator(processes, namespace=f'/rank_{rank}')
    first, second = agents(processes, run, iterations=10_000, simulators='/rank_{rank}')
    first.wait_for('PPO 1/10000', 60.0)
    second.signal(number)
    assert first.wait(20.0) == 2, processes.logs()
    assert 'rank 0 of 2 has lost another rank' in first.output()
    assert 'Traceback' not in first.output()
    assert re.search(
        'stopped; resume, with the same simulators, and all other ranks likewise, by: env RANK=0 '
        r'WORLD_SIZE=2 MASTER_ADDR=127.0.0.1 MASTER_PORT=\d+ ros2 run', first.output())
    assert list((run / 'checkpoints').glob('iteration_*.safetensors'))
    if number == signal.SIGINT:
        assert second.wait(10.0) == 0, processes.logs()
        assert 'stopped; a resumed run continues from here' in second.output()


def test_an_agent_that_waits_for_the_others_can_be_stopped(
        processes: Processes, tmp_path: Path) -> None:
    simulator(processes, namespace='/rank_0')
    first, second = agents(processes, tmp_path / 'run')
    second.signal(signal.SIGKILL)
    first.wait_for('rank 0 of 2: waiting for the others at 127.0.0.1:', 30.0)
    first.signal(signal.SIGINT)
    assert first.wait(10.0) == 0, processes.logs()
    assert 'stopped before the training began' in first.output()
    assert not (tmp_path / 'run').exists()
