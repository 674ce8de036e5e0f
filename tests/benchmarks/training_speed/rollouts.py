# SPDX-License-Identifier: Apache-2.0
"""Speed of training roll-outs over DDS, with one and two simulators, and in one process.

The same policy flies the same flights into the same buffers; only the access to worlds differs.
In process, there are two cases: all rockets in one world, which is fastest there, and as many
worlds as there are simulators, where both loops do exactly the same work. All cases are measured
alternately and medians are reported; the flights are compared, bit for bit.

Two ratios of measured parts show what one simulator could reach if it never worked at the same
time as its agent and both had a core of their own: the loop in process plus an exchange per step,
by DDS, or by a TCP ping-pong of the same bytes, which is the floor. "Apart" are roll-outs in which
agent and simulator are pinned to a core each.
"""
from __future__ import annotations

import argparse
import functools
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from support.processes import Processes

from benchmarks.wire.agent_node import agent_node
from benchmarks.wire.exchange import microseconds
from benchmarks.wire.exchange import on_core
from benchmarks.wire.exchange import still_simulator
from benchmarks.wire.tcp_floor import TcpFloor
from ppo_agent_node import random_streams
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.rollout_buffer import Rollout
from rocket_sim_node import worlds
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.fleet import SimulatorFleet
from rocket_sim_node.worlds.jobs import Fleet
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import Snapshot

SIZES = (256, 512, 1024, 2048)
_START = 60.0
"""time limit for a node to start, s"""


def start(group: int) -> Job[bytes]:
    """Start episodes and return a snapshot of their starts."""
    yield Reset(group, {'level': 7})
    state: bytes = yield Snapshot()
    return state


def shipped_policy() -> Policy:
    """Return the shipped policy of the rocket; make torch use one thread, as in flight."""
    torch.set_num_threads(1)
    policy, _ = load_policy(
        find_policy('', 'rocket', Path(os.devnull)), worlds.make('rocket', 1).spec)
    return policy


class Course:
    """Roll-outs of T steps in a fleet, one after the other."""

    def __init__(self, fleet: Fleet, groups: int, steps: int, policy: Policy) -> None:
        """Start the episodes."""
        self._fleet, self._policy, self._count = fleet, policy, 0
        spec = fleet.spec
        self.rollout = Rollout(steps, spec.num_envs, spec.observation_size, policy, groups)
        self._worlds = list(fleet.fly([functools.partial(start, k) for k in range(groups)]))

    def __call__(self) -> float:
        """Fly a roll-out and return rocket steps per second."""
        self._count += 1

        def begin(group: int) -> Any:
            noise = random_streams.generator(1, 'roll-out', self._count, group)
            return self.rollout.flight(
                group, Restore(self._worlds[group]), self._policy, noise)

        began = time.perf_counter()
        self._worlds = [world for _, world in self._fleet.fly(
            [functools.partial(begin, k) for k in range(len(self._worlds))])]
        return self.rollout.reward.numel() / (time.perf_counter() - began)


@contextmanager
def wire_fleet(folder: Path, simulators: int, num_envs: int) -> Iterator[SimulatorFleet]:
    """Run simulators in processes of their own and yield them as a fleet."""
    with wire_simulators(folder, simulators, num_envs) as (fleet, _):
        yield fleet


@contextmanager
def wire_simulators(
    folder: Path, simulators: int, num_envs: int,
) -> Iterator[tuple[SimulatorFleet, list[int]]]:
    """Run simulators in processes of their own; yield them as a fleet, and their process ids."""
    with ExitStack() as stack:
        processes = Processes(folder)
        stack.callback(processes.end)
        started = [
            processes.run_node(
                'rocket_sim_node', 'simulator', (f'__ns:=/sim_{k}',), num_envs=num_envs, level=7)
            for k in range(simulators)]
        for process in started:
            process.wait_for('waiting for an agent', _START)
        node, executor = stack.enter_context(
            agent_node(f'bench_rollouts_{simulators}', processes.domain))
        fleet = stack.enter_context(SimulatorFleet(
            node, executor, ConnectionOptions(), 1, '/sim_*'))
        yield fleet, [process.pid for process in started]


def measure(rockets: int, steps: int, rounds: int, policy: Policy) -> dict[str, Any]:
    """Return medians over rounds for a total number of rockets."""
    def in_process(groups: int) -> SerialFleet:
        return SerialFleet(*(
            worlds.make('rocket', rockets // groups, level=7) for _ in range(groups)))

    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        courses: dict[str, Callable[[], float]] = {}
        twins = []
        pids: list[int] = []
        for simulators in (1, 2):
            (Path(folder) / str(simulators)).mkdir()
            fleet, running = stack.enter_context(
                wire_simulators(Path(folder) / str(simulators), simulators, rockets // simulators))
            pids += running
            twin = Course(in_process(simulators), simulators, steps, policy)
            course = Course(fleet, simulators, steps, policy)
            courses[f'DDS, {simulators}'] = course
            courses[f'in process, {simulators}'] = twin
            for one in (twin, course):
                one()
            twins.append(all(
                torch.equal(getattr(twin.rollout, name), getattr(course.rollout, name))
                for name in ('observation', 'action', 'log_prob', 'reward', 'terminated')))
        speeds: dict[str, list[float]] = {name: [] for name in courses}
        floor = TcpFloor(rockets, core=1)
        stack.callback(floor.close)
        client, simulator = stack.enter_context(still_simulator(rockets))
        command = np.zeros((rockets, 3), np.float32)
        pings: list[float] = []
        exchanges: list[float] = []
        apart: list[float] = []
        for _ in range(rounds):
            for name, course in courses.items():
                speeds[name].append(course())
            with on_core(0), on_core(1, pids[0]):
                apart.append(courses['DDS, 1']())
            with on_core(0), on_core(1, simulator.pid):
                pings.append(microseconds(floor, steps)[0])
                exchanges.append(microseconds(lambda: client.step(command), steps)[0])

    def with_exchange(times: list[float]) -> float:
        alone = rockets / statistics.median(speeds['in process, 1'])
        return alone / (alone + 1e-6 * statistics.median(times))

    return {
        'equal': all(twins), 'ratio_apart': ratio(apart, speeds['in process, 1']),
        'dds_parts': with_exchange(exchanges),
        'tcp_parts': with_exchange(pings),
        'steps_per_second': {
            name: statistics.median(values) for name, values in speeds.items()},
        'ratio': {
            name: ratio(values, speeds['in process, 1']) for name, values in speeds.items()},
        'ratio_of_equals': {
            f'DDS, {count}': ratio(speeds[f'DDS, {count}'], speeds[f'in process, {count}'])
            for count in (1, 2)}}


def ratio(values: list[float], others: list[float]) -> float:
    """Return the median ratio of two speeds over the rounds."""
    return statistics.median(v / w for v, w in zip(values, others, strict=True))


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench rollouts', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=9, help='number of rounds')
    parser.add_argument('--steps', type=int, default=256, help='steps per rocket in a roll-out')
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES),
                        help='numbers of rockets')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    policy = shipped_policy()
    print(f'rocket steps/s of roll-outs of {options.steps} steps, median of {options.rounds} '
          'rounds; DDS: simulators in processes of their own; apart: one, with a core each')
    print(f'{"rockets":>8}{"in process":>12}{"one sim.":>12}{"ratio":>7}{"apart":>7}'
          f'{"two worlds":>12}{"two sim.":>12}{"ratio":>7}{"of equals":>11}'
          f'{"DDS parts":>11}{"TCP parts":>11}  bits equal')
    table = {}
    for size in options.sizes:
        figures = table[size] = measure(size, options.steps, options.rounds, policy)
        speed, ratios = figures['steps_per_second'], figures['ratio']
        print(f'{size:>8}{speed["in process, 1"]:>12,.0f}{speed["DDS, 1"]:>12,.0f}'
              f'{ratios["DDS, 1"]:>7.2f}{figures["ratio_apart"]:>7.2f}'
              f'{speed["in process, 2"]:>12,.0f}{speed["DDS, 2"]:>12,.0f}'
              f'{ratios["DDS, 2"]:>7.2f}{figures["ratio_of_equals"]["DDS, 2"]:>11.2f}'
              f'{figures["dds_parts"]:>11.2f}{figures["tcp_parts"]:>11.2f}'
              f'  {"yes" if figures["equal"] else "NO"}', flush=True)
    if options.output:
        write_json(options.output, {'steps': options.steps, 'rollouts': table})


if __name__ == '__main__':
    main()
