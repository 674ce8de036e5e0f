# SPDX-License-Identifier: Apache-2.0
"""Cost of conditions: steps per second of the rocket worlds under them, on one core.

All cases are measured alternately in several rounds, in processor time. Medians are reported.
Engines burn at about half throttle.
"""
from __future__ import annotations

import argparse
import os
import statistics
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import SimulatedWorld

_SETS = ('nominal', 'mix', 'harsh')
_WORLDS = ('rocket', 'rocket_planar')


def rate(world: SimulatedWorld, actions: NDArray[np.float64], seconds: float) -> float:
    """Return environment steps per second of processor time, measured for about `seconds`."""
    count, start = 0, time.process_time()
    while (elapsed := time.process_time() - start) < seconds:
        for action in actions:
            world.step(action)
        count += len(actions)
    return count * actions.shape[1] / elapsed


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench conditions', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=5, help='number of rounds')
    parser.add_argument(
        '--seconds', type=float, default=0.5, help='duration of one measurement, s')
    parser.add_argument('--sizes', type=int, nargs='+', default=[256, 1024], help='batch sizes')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    figures = []
    for world in _WORLDS:
        for size in options.sizes:
            actions = np.random.default_rng(0).uniform(-1, 1, (16, size, 3)) * (0.1, 0.1, 0.1)
            made = {name: worlds.make(world, size, 1, conditions=name) for name in _SETS}
            rates: dict[str, list[float]] = {name: [] for name in _SETS}
            for _ in range(options.rounds):
                for name, env in made.items():
                    rates[name].append(rate(env, actions, options.seconds))
            medians = {name: statistics.median(found) for name, found in rates.items()}
            ratios = {name: found / medians['nominal'] for name, found in medians.items()}
            print(f'{world:14s}{size:6d}', *(
                f'{name} {medians[name]:11,.0f} steps/s ({ratios[name]:.2f})' for name in _SETS))
            figures.append({
                'world': world, 'num_envs': size, 'steps_per_second': medians, 'ratio': ratios})
    if options.output:
        write_json(options.output, {'figures': figures})


if __name__ == '__main__':
    main()
