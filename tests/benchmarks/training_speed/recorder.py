# SPDX-License-Identifier: Apache-2.0
"""Speed of simulator and agent, with and without a node that subscribes to their topics.

The nodes are `rerun_recorder`, `bag_recorder`, which records all topics, and `ros_bridge`, alone
and with a viewer that subscribes to all of its topics. One simulator and one agent run all the
time, and the node is started and ended alternately. In this way both cases have the same processes
and the same disturbances. Each turn with the node is compared with the turns before and after it.
The interval is Student's, for the mean logarithm of these ratios. Turns differ by more than the
cost of a node, so many of them are needed. One part measures an agent that trains, some of whose
flights are recorded; the other a policy that flies, with all flights of the first four rockets
recorded.
"""
from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import stats
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

from ppo_agent_node.evaluation.metrics import write_json

NODES = {
    'rerun_recorder': 'recording to', 'bag_recorder': 'recording to',
    'ros_bridge': 'publishing standard views',
    'ros_bridge_viewed': 'publishing standard views'}
"""nodes, and what each logs after its start; the last is `ros_bridge` with a viewer"""
PARTS = ('training', 'flying')
_MISSED = re.compile(r'(\d+)(?= steps were not received)|(?<=DDS lost )(\d+)')
_START = 60.0
"""time limit for a node to start, s"""


@dataclass
class Speeds:
    """Steps/s of n turns with a node and of n + 1 turns without; processor time of the node."""

    without: list[float] = field(default_factory=list)
    beside: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    recorded: int = 0
    """messages in bags"""
    missed: int = 0
    """messages that are missing in bags, as the recorder reports"""

    def summary(self) -> dict[str, Any]:
        """Return medians, and the mean ratio with its 95 % interval."""
        around = np.log(self.without)
        change = np.log(self.beside) - (around[:-1] + around[1:]) / 2
        # Consecutive changes share a turn without the node. If all turns have equal variance, the
        # covariance is 1/6 of it, and the variance of the mean is 4/3 of the usual one.
        mean, error = float(change.mean()), float(change.std(ddof=1)) * (4 / 3 / len(change))**0.5
        reach = float(stats.t.ppf(0.975, len(change) - 1)) * error
        return {
            'without': statistics.median(self.without), 'with': statistics.median(self.beside),
            'ratio': math.exp(mean), 'low': math.exp(mean - reach),
            'high': math.exp(mean + reach), 'node_cpu': statistics.median(self.cpu),
            'recorded': self.recorded, 'missed': self.missed,
            'turns': len(self.beside), 'all_without': self.without, 'all_with': self.beside}


def cpu_seconds(pid: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f'/proc/{pid}/stat').read_text('utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def node_of(process: Process) -> int:
    """Return the process id of the node: that of `ros2 run` itself or of its child."""
    children = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text('utf-8').split()
    return int(children[0]) if children else process.pid


@contextmanager
def listener(processes: Processes, name: str, number: int, speeds: Speeds) -> Iterator[int]:
    """Run the node and yield its process id; count recorded and missed messages of a bag."""
    path = processes.folder / f'{number}.{"rrd" if name == "rerun_recorder" else "bag"}'
    views = name.startswith('ros_bridge')
    node = processes.run_node(
        'rocket_sim_node', 'ros_bridge' if views else name, **({} if views else {'output': path}))
    node.wait_for(NODES[name], _START)
    viewer = None
    if name == 'ros_bridge_viewed':
        viewer = processes.start(sys.executable, '-m', 'support.users.views_subscriber')
        viewer.wait_for('subscribed', _START)
    try:
        yield node_of(node)
    finally:
        if viewer is not None:
            viewer.end()
        node.end()
        if name == 'bag_recorder':
            metadata = yaml.safe_load((path / 'metadata.yaml').read_text('utf-8'))
            speeds.recorded += metadata['rosbag2_bagfile_information']['message_count']
            speeds.missed += _missed(node.output())
            shutil.rmtree(path)
        path.unlink(missing_ok=True)


def _missed(output: str) -> int:
    """Return the number of messages that a recorder says it missed.

    A message that DDS lost is also counted as a missed step; the larger number is used.
    """
    return sum(max(int(found[0]) for found in _MISSED.finditer(line))
               for line in output.splitlines() if _MISSED.search(line))


class Log:
    """The log of a training run, read as it grows."""

    def __init__(self, path: Path, agent: Process) -> None:
        self._path, self._agent = path, agent
        self._read = 0

    def _lines(self) -> list[dict[str, Any]]:
        text = self._path.read_text('utf-8') if self._path.exists() else ''
        return [json.loads(line) for line in text.splitlines(keepends=True)
                if line.endswith('\n')]

    def next(self, count: int) -> list[float]:
        """Return the steps/s of the next `count` iterations that begin from now on."""
        first = len(self._lines()) + 1  # the current iteration began before
        wait_until(
            lambda: len(self._lines()) >= first + count or not self._agent.running, 600.0,
            self._agent.output)
        rates = [line['steps_per_second'] for line in self._lines()[first:first + count]]
        assert len(rates) == count, self._agent.output()
        return rates


def measure(
    processes: Processes, name: str, turns: int, rate: Callable[[], float], speeds: Speeds,
) -> None:
    """Measure a rate alternately with and without a node."""
    speeds.without.append(rate())
    for turn in range(turns):
        with listener(processes, name, turn, speeds) as pid:
            began, used = time.monotonic(), cpu_seconds(pid)
            speeds.beside.append(rate())
            speeds.cpu.append((cpu_seconds(pid) - used) / (time.monotonic() - began))
        speeds.without.append(rate())


def training(folder: Path, name: str, turns: int, iterations: int) -> Speeds:
    """Measure while an agent trains."""
    processes, speeds = Processes(folder), Speeds()
    try:
        simulator = processes.run_node('rocket_sim_node', 'simulator', num_envs=256)
        simulator.wait_for('waiting for an agent', _START)
        run = folder / 'run'
        agent = processes.run_node(
            'ppo_agent_node', 'ppo_agent', run_dir=run, iterations=1000,
            demonstration_episodes=0, selection_interval=1_000_000)
        log = Log(run / 'train.jsonl', agent)
        log.next(2)

        def rate() -> float:
            return statistics.mean(log.next(iterations))

        measure(processes, name, turns, rate, speeds)
    finally:
        processes.end()
    return speeds


def flying(folder: Path, name: str, turns: int, seconds: float) -> Speeds:
    """Measure while a policy flies."""
    from benchmarks.wire.agent_node import agent_node
    from ppo_agent_node.pilots.policy import PolicyPilot
    from ppo_agent_node.pilots.search import find_policy
    from rocket_sim_node.wire.client.client import Client

    processes, speeds = Processes(folder), Speeds()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    with agent_node('bench_recorder', processes.domain) as (node, executor):
        try:
            processes.run_node('rocket_sim_node', 'simulator', num_envs=256).wait_for(
                'waiting for an agent', _START)
            with Client(node, executor) as client:
                pilot = PolicyPilot(find_policy('', 'rocket', folder), client.spec)
                observation = client.reset(0)

                def rate() -> float:
                    nonlocal observation
                    count, start = 0, time.perf_counter()
                    while (elapsed := time.perf_counter() - start) < seconds:
                        for _ in range(50):
                            observation = client.step(pilot(observation))[0]
                        count += 50 * client.spec.num_envs
                    return count / elapsed

                rate()
                measure(processes, name, turns, rate, speeds)
        finally:
            processes.end()
    return speeds


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench recorder', description=__doc__.split('\n')[0])
    parser.add_argument(
        '--nodes', nargs='+', choices=list(NODES), default=list(NODES), help='nodes that listen')
    parser.add_argument(
        '--turns', type=int, default=7, help='turns with a node, and as many without')
    parser.add_argument(
        '--iterations', type=int, default=3, help='iterations of training per turn')
    parser.add_argument('--seconds', type=float, default=8.0, help='seconds of flying per turn')
    parser.add_argument(
        '--parts', nargs='+', choices=PARTS, default=list(PARTS), help='parts to measure')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if options.turns < 2:
        parser.error(f'--turns: got {options.turns}, expected 2 or more: one has no interval')
    print(f'{"rocket steps/s":<26}{"without":>10}{"with":>10}{"ratio":>8}{"95 %":>16}'
          f'{"turns":>7}{"node":>18}{"messages":>12}{"missed":>8}')
    figures = {}
    for name in options.nodes:
        for part in options.parts:
            with tempfile.TemporaryDirectory() as folder:
                speeds = (
                    training(Path(folder), name, options.turns, options.iterations)
                    if part == 'training'
                    else flying(Path(folder), name, options.turns, options.seconds))
            figures[f'{name}, {part}'] = summary = speeds.summary()
            share = f'{100 * summary["node_cpu"]:.1f} % of a core'
            interval = f'[{summary["low"]:.3f}, {summary["high"]:.3f}]'
            kept = f'{summary["recorded"]:>12,}{summary["missed"]:>8,}'
            print(f'{name + ", " + part:<26}{summary["without"]:>10,.0f}{summary["with"]:>10,.0f}'
                  f'{summary["ratio"]:>8.3f}{interval:>16}{summary["turns"]:>7}{share:>18}'
                  + (kept if name == 'bag_recorder' else ''), flush=True)
    if options.output:
        write_json(options.output, figures)


if __name__ == '__main__':
    main()
