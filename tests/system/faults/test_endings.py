# SPDX-License-Identifier: Apache-2.0
"""Nodes that are stopped or refused during their start leave nothing behind."""
from __future__ import annotations

import signal
from pathlib import Path

import psutil
import pytest
from support.processes import Process
from support.processes import Processes
from support.training.faults import END
from support.training.faults import Moments
from support.training.training_runs import agent
from support.training.training_runs import fresh_agent
from support.training.training_runs import fresh_simulator

ROUNDS, NIGHTLY_ROUNDS = 2, 50
START = 2.0
"""s within which a node has started, on a quiet machine"""

pytestmark = pytest.mark.timeout(900)


def start(processes: Processes, node: str, folder: Path) -> Process:
    """Start a node that would write into a folder."""
    if node == 'simulator':
        return fresh_simulator(processes)
    if node == 'agent':
        return fresh_agent(processes, folder / 'run')
    return processes.run_node('rocket_sim_node', 'rerun_recorder', output=folder / 'flights.rrd')


@pytest.mark.parametrize('node', ['simulator', 'agent', 'recorder'])
def test_a_node_signalled_during_its_start_leaves_nothing(
        processes: Processes, tmp_path: Path, nightly: bool, node: str) -> None:
    moments = Moments()
    for number in range(NIGHTLY_ROUNDS if nightly else ROUNDS):
        folder = tmp_path / str(number)
        folder.mkdir()
        sent = moments.random.choice([signal.SIGINT, signal.SIGTERM])
        process = start(processes, node, folder)
        # Some within the first milliseconds.
        moments.wait(moments.random.choice([0.05, START]))
        process.signal(sent)
        # While Python itself starts, the signal ends it, and Python prints a traceback.
        status = process.wait(END)
        assert status in (0, -sent, 130) or (
            status == 1 and 'KeyboardInterrupt' in process.output()), process.output()
        assert not [file for file in folder.rglob('*') if file.is_file() and file.stat().st_size]


def test_fast_dds_maps_no_shared_memory(processes: Processes, tmp_path: Path) -> None:
    """Nothing is left there, therefore, when a node is killed."""
    nodes = [start(processes, node, tmp_path) for node in ('simulator', 'agent', 'recorder')]
    for node, line in zip(nodes, ('waiting for an agent', 'expert flies', 'recording to'),
                          strict=True):
        node.wait_for(line, 60.0)
    for node in nodes:
        family = psutil.Process(node.pid)
        for process in (family, *family.children(recursive=True)):
            mapped = Path(f'/proc/{process.pid}/maps').read_text('utf-8')
            assert '/dev/shm/fast' not in mapped, node.output()


def refusal(process: Process) -> list[str]:
    """Return what was printed by a node whose start was refused, the reason in the last line."""
    assert process.wait(END) == 2, process.output()
    # `ros2 run` of a ROS 2 that is installed adds a line of its own.
    lines = [line for line in process.output().splitlines() if not line.startswith('[ros2run]')]
    assert 'Traceback' not in process.output()
    assert [line for line in lines if '[FATAL]' in line] == lines[-1:], process.output()
    return lines


@pytest.mark.parametrize(('parameters', 'word'), [
    ({'clip_rang': 0.1}, 'clip_rang'), ({'clip_range': -1.0, 'resume': True}, 'clip_range'),
    ({'simulators': 'sim_*'}, 'sim_*'),
])
def test_a_refused_start_leaves_no_folder(
        processes: Processes, tmp_path: Path, parameters: dict, word: str) -> None:
    (line,) = refusal(agent(processes, tmp_path / 'run', **parameters))
    assert word in line
    assert not (tmp_path / 'run').exists()


def test_an_agent_refused_for_its_world_leaves_no_folder(
        processes: Processes, tmp_path: Path) -> None:
    processes.run_node('rocket_sim_node', 'simulator', num_envs=8, mode='realtime')
    lines = refusal(agent(processes, tmp_path / 'run'))
    assert 'lockstep' in lines[-1]
    assert not (tmp_path / 'run').exists()


def test_a_run_without_landed_demonstrations_offers_no_resume(
        processes: Processes, tmp_path: Path) -> None:
    """It would fail again; the run folder is kept for inspection."""
    processes.run_node('rocket_sim_node', 'simulator', num_envs=8, fuel=20.0)
    ended = agent(processes, tmp_path / 'run')
    assert ended.wait(2 * END) == 2, ended.output()
    assert 'none landed' in ended.output()
    assert 'resume:=true' not in ended.output()
    assert (tmp_path / 'run/config.yaml').exists()
    assert not (tmp_path / 'run/.unfinished').exists()
