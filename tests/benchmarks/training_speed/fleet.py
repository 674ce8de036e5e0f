# SPDX-License-Identifier: Apache-2.0
"""Cost to the agent of each further simulator, with 1 to 16 small simulators for one agent.

Each simulator flies the same flights. The agent ignores the observations, so it spends its time
on communication. This time is measured as processor time of all threads of the agent's process,
because the simulators share the machine with it.
"""
from __future__ import annotations

import argparse
import functools
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.training_speed.rollouts import shipped_policy
from benchmarks.training_speed.rollouts import wire_fleet
from benchmarks.wire.exchange import microseconds
from benchmarks.wire.tcp_floor import sizes
from ppo_agent_node import random_streams
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import worlds
from rocket_sim_node.wire.client.fleet import SimulatorFleet
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset

COUNTS = (1, 2, 4, 8, 16)
BATCH = 256
"""number of rockets of a simulator, for the estimate of costs"""
BUSY = 4
"""number of simulators for the estimate of costs; while an agent waits for one, it polls, which
counts as processor time"""


def idle(num_envs: int, steps: int) -> Job[None]:
    """Fly with the engine off."""
    action = np.tile(np.float32([-1.0, 0.0, 0.0]), (num_envs, 1))
    yield Reset(1, {'level': 7})
    for _ in range(steps):
        yield action


def fly(fleet: SimulatorFleet, simulators: int, num_envs: int, steps: int) -> tuple[float, float]:
    """Return wall-clock time and the agent's processor time per exchange, s."""
    wall, cpu = time.perf_counter(), time.process_time()
    list(fleet.fly([functools.partial(idle, num_envs, steps)] * simulators))
    exchanges = simulators * steps
    return (time.perf_counter() - wall) / exchanges, (time.process_time() - cpu) / exchanges


def measure(simulators: int, num_envs: int, steps: int, rounds: int) -> dict[str, Any]:
    """Return medians over rounds for a number of simulators."""
    with tempfile.TemporaryDirectory() as folder, wire_fleet(
            Path(folder), simulators, num_envs) as fleet:
        fly(fleet, simulators, num_envs, steps // 4)
        samples = [fly(fleet, simulators, num_envs, steps) for _ in range(rounds)]
    wall, cpu = (statistics.median(values) for values in zip(*samples, strict=True))
    return {
        'wall_us': 1e6 * wall, 'cpu_us': 1e6 * cpu, 'exchanges_per_second': 1 / wall,
        'all_cpu_us': [1e6 * c for _, c in samples]}


def other_costs() -> dict[str, float]:
    """Return the other costs that limit the number of simulators, for one batch."""
    world = worlds.make('rocket', BATCH, level=7)
    observation = torch.from_numpy(world.reset(1))
    generator = random_streams.generator(1, 'bench')
    sample = shipped_policy().sampler(torch.zeros(200, BATCH), generator)
    command = np.zeros((BATCH, 3), np.float32)
    return {
        'inference_us': microseconds(lambda: sample(0, observation), 200)[0],
        'physics_us': microseconds(lambda: world.step(command), 200)[0],
        'bytes_per_exchange': sum(sizes(BATCH))}


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench fleet', description=__doc__.split('\n')[0])
    parser.add_argument('--counts', type=int, nargs='+', default=list(COUNTS),
                        help='numbers of simulators')
    parser.add_argument('--num-envs', type=int, default=16, help='rockets per simulator')
    parser.add_argument('--steps', type=int, default=500, help='steps of a flight')
    parser.add_argument('--rounds', type=int, default=5, help='number of rounds')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(f'simulators of {options.num_envs} rockets; an exchange with one of them, medians of '
          f'{options.rounds} rounds')
    print(f'{"simulators":>11}{"agent CPU, us":>15}{"of one":>8}{"wall, us":>10}'
          f'{"exchanges/s":>13}')
    table: dict[int, dict[str, Any]] = {}
    for count in options.counts:
        figures = table[count] = measure(
            count, options.num_envs, options.steps, options.rounds)
        figures['ratio'] = figures['cpu_us'] / table[options.counts[0]]['cpu_us']
        print(f'{count:>11}{figures["cpu_us"]:>15.0f}{figures["ratio"]:>8.2f}'
              f'{figures["wall_us"]:>10.0f}{figures["exchanges_per_second"]:>13,.0f}', flush=True)
    costs = other_costs()
    costs['wire_us'] = measure(BUSY, BATCH, options.steps, options.rounds)['cpu_us']
    print(f'a batch of {BATCH} rockets: {costs["wire_us"]:.0f} us of agent CPU for an exchange, '
          f'{costs["inference_us"]:.0f} us of inference, {costs["physics_us"]:.0f} us of physics, '
          f'{costs["bytes_per_exchange"]:,} bytes')
    if options.output:
        write_json(
            options.output, {'num_envs': options.num_envs, 'fleet': table, **costs})


if __name__ == '__main__':
    main()
