# SPDX-License-Identifier: Apache-2.0
"""Disks that fill up, turn read-only or lose a folder while nodes write to them."""
from __future__ import annotations

import json
import shutil
import signal
import subprocess
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from support.machine.disks import Disk
from support.machine.disks import read_only
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.training.training_runs import agent
from support.training.training_runs import assert_same_run
from support.training.training_runs import simulator
from support.training.training_runs import train_in_process

from ppo_agent_node.runs.folder import RunFolder
from rocket_sim_node.recording import reader
from rocket_sim_node.recording.sinks.file_sink import partial_path
from rocket_sim_node.wire.client.client import Client


@pytest.fixture
def make_disk(tmp_path: Path) -> Iterator[Callable[[int], Disk]]:
    """Disks of some MiB."""
    disks = []

    def make(mebibytes: int) -> Disk:
        try:
            disk = Disk(tmp_path / f'disk_{len(disks)}', mebibytes)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f'no disk can be mounted here: {error}')
        disks.append(disk)
        return disk

    yield make
    for disk in disks:
        disk.close()


def held(node: Process, text: str) -> Process:
    """Hold a node when it has printed something, until it gets SIGCONT."""
    node.wait_for(text, 60.0)
    node.signal(signal.SIGSTOP)
    return node


def assert_clear_error(node: Process, processes: Processes, *words: str) -> None:
    """Let a held node go on, and assert that it ends with an error that says why."""
    node.signal(signal.SIGCONT)
    assert node.wait(60.0) == 2, processes.logs()
    assert 'Traceback' not in node.output(), node.output()
    for word in words:
        assert word in node.output(), node.output()


def assert_whole(run: Path) -> None:
    """Assert that the newest checkpoint of a run is whole and nothing is half-written."""
    found = RunFolder(run, resume=True).newest(pytest.fail)
    assert found is not None
    assert not list(run.rglob('*.part'))


def test_training_on_a_disk_that_fills_up_or_turns_read_only(
        processes: Processes, tmp_path: Path, make_disk: Callable[[int], Disk]) -> None:
    disk = make_disk(8)
    run = disk.path / 'run'
    simulator(processes)
    first = held(agent(processes, run), 'PPO 1/')
    disk.fill()
    assert_clear_error(first, processes, str(run), 'No space left on device')
    disk.free()
    assert_whole(run)
    second = held(agent(processes, run, resume=True), 'PPO 2/')
    with read_only(run / 'checkpoints'):
        assert_clear_error(second, processes, str(run / 'checkpoints'), 'Read-only file system')
    with read_only(run):
        refused = agent(processes, run, resume=True)
        assert_clear_error(refused, processes, str(run), 'not writable: Read-only file system')
    last = agent(processes, run, resume=True)
    assert last.wait(120.0) == 0, processes.logs()
    # A file begun before its folder turned read-only stays until this start removes it.
    assert_whole(run)
    assert_same_run(run, train_in_process(tmp_path / 'reference'))


def test_a_run_folder_that_is_removed_ends_the_training(
        processes: Processes, tmp_path: Path) -> None:
    run = tmp_path / 'run'
    simulator(processes)
    trainer = held(agent(processes, run), 'PPO 1/')
    shutil.rmtree(run)
    assert_clear_error(trainer, processes, str(run), 'No such file or directory')
    assert not run.exists()


def test_evaluation_and_recording_on_a_full_disk(
        processes: Processes, make_disk: Callable[[int], Disk]) -> None:
    disk = make_disk(40)
    recording = disk.path / 'flights.rrd'
    recorder = processes.run_node('rocket_sim_node', 'rerun_recorder', output=recording)
    recorder.wait_for('recording to', 60.0)
    partial = partial_path(recording)
    begun = partial.stat().st_size
    simulator(processes)
    # It hears the simulator and has drawn the world: no flight escapes it.
    wait_until(lambda: partial.stat().st_size > begun, 60.0)
    output = disk.path / 'evaluation'
    # One flight after the other, so that some end before the disk is full.
    evaluation = held(processes.fork_node(
        'ppo_agent_node', 'evaluate', pilot='expert', episodes=40, level=1, output=output),
        ' 32/40')
    wait_until(lambda: partial.stat().st_size > 500_000, 60.0)  # some flights are in it
    disk.fill()
    assert_clear_error(evaluation, processes, str(output), 'No space left on device')
    files = [path for path in output.rglob('*') if path.is_file()]
    assert {path.name for path in files} <= {'evaluation.json', 'episodes.csv'}
    if (output / 'evaluation.json').exists():
        json.loads((output / 'evaluation.json').read_text())
    recorder.wait_for('the recording ends here', 60.0)
    assert recorder.wait(30.0) == (0 if recording.exists() else 2), processes.logs()
    if not recording.exists():
        # The disk was full within a flight: the next one makes of it what can be made.
        assert 'could not be finished and remains at' in recorder.output()
        disk.free()
        processes.run_node('rocket_sim_node', 'rerun_recorder', output=recording).wait_for(
            'its recording is repaired', 60.0)
        check = processes.start('rerun', 'rrd', 'verify', str(recording))
        assert check.wait(30.0) == 0, check.output()
    assert reader.trajectories(recording)


def test_a_bag_on_a_full_disk(
        processes: Processes, make_disk: Callable[[int], Disk]) -> None:
    disk = make_disk(40)
    bag = disk.path / 'bag'
    recorder = processes.run_node('rocket_sim_node', 'bag_recorder', output=bag)
    simulator(processes)
    processes.run_node('ppo_agent_node', 'random_pilot', episodes=0)
    partial = disk.path / 'bag.partial/bag_0.mcap'
    wait_until(lambda: partial.exists() and partial.stat().st_size > 100_000, 60.0)
    disk.fill()
    recorder.wait_for('the bag ends here', 60.0)
    assert recorder.wait(30.0) == (0 if bag.exists() else 2), processes.logs()
    assert 'Traceback' not in recorder.output()
    if not bag.exists():
        # The disk was full before the index was written: the next one repairs the bag.
        assert 'could not be finished and remains at' in recorder.output()
        disk.free()
        processes.run_node('rocket_sim_node', 'bag_recorder', output=bag).wait_for(
            'its bag is repaired', 60.0)
    with AnyReader([bag]) as found:
        assert found.message_count > 100


def test_a_real_time_flight_continues_while_ros_time_stands_still(
        processes: Processes, make_client: Callable[..., Client]) -> None:
    """ROS time stands still here, as for a timer of ROS after the clock was set back."""
    processes.run_node(
        'rocket_sim_node', 'simulator', num_envs=1, mode='realtime', realtime_factor=5.0,
        use_sim_time=True)
    client = make_client()
    observation = client.reset(1, level=1)
    idle = np.tile(np.float32(client.spec.action_idle), (1, 1))
    heights = [float(observation[0, 1])]
    for _ in range(10):
        heights.append(float(client.step(idle)[0][0, 1]))
    assert heights[-1] < heights[0]
