# SPDX-License-Identifier: Apache-2.0
"""Steps per second of `lunar_lander`, `rocket`, EnvPool and Gymnasium on one core.

Random actions, episodes and resets are included. The peers and this project are measured
alternately in several rounds, so that disturbances affect all of them. Medians are reported.
"""
from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import worlds

SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16_384)
_LARGEST = {'lunar_lander': 4096, 'EnvPool': 4096, 'Gymnasium': 64}
"""maximum number of environments; more are not faster (Gymnasium's vector is a loop)"""

OUR_WORLDS = ('lunar_lander', 'rocket')
Stepper = Callable[[NDArray[Any]], Any]


def ours(num_envs: int) -> Stepper:
    """Return the step of our lander's world."""
    return worlds.make('lunar_lander', num_envs=num_envs, seed=1).step


def rocket(num_envs: int) -> Stepper:
    """Return the step of world `rocket`, three-dimensional, with continuous actions."""
    return worlds.make('rocket', num_envs=num_envs, seed=1, level=7).step


def envpool(num_envs: int) -> Stepper:
    """Return the step of EnvPool's lander: synchronous, one thread, as advised for one core."""
    import envpool

    env = envpool.make(
        'LunarLander-v3', env_type='gymnasium', num_envs=num_envs, batch_size=num_envs,
        num_threads=1, seed=1)
    env.reset()
    return lambda action: env.step(action.astype(np.int32))


def gymnasium_sync(num_envs: int) -> Stepper:
    """Return the step of Gymnasium's own vector environment."""
    env = gymnasium.make_vec(
        'LunarLander-v3', num_envs=num_envs, vectorization_mode='sync',
        vector_kwargs={'autoreset_mode': AutoresetMode.SAME_STEP})
    env.reset(seed=1)
    return env.step


def random_actions(name: str, num_envs: int) -> NDArray[Any]:
    """Return 16 batches of actions for a world, uniform over its action space."""
    rng = np.random.default_rng(0)
    if name == 'rocket':
        return rng.uniform(-1, 1, (16, num_envs, 3)).astype(np.float32)
    return rng.integers(0, 4, (16, num_envs))


def rate(step: Stepper, actions: NDArray[Any], seconds: float) -> float:
    """Return environment steps per second, measured for about `seconds`."""
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        for action in actions:
            step(action)
        count += len(actions)
    return count * actions.shape[1] / elapsed


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench stepping', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=5, help='number of rounds')
    parser.add_argument(
        '--seconds', type=float, default=0.5, help='duration of one measurement, s')
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES), help='batch sizes')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    peers = {
        'lunar_lander': ours, 'rocket': rocket, 'EnvPool': envpool, 'Gymnasium': gymnasium_sync}
    if importlib.util.find_spec('envpool') is None:
        print('EnvPool is not installed; ./launch_scripts/bench stepping installs it')
        del peers['EnvPool']
    table: dict[str, dict[int, float]] = {name: {} for name in peers}
    print(f'steps/s on one core, median of {options.rounds} rounds, random actions')
    print(f'{"batch":>6}' + ''.join(f'{name:>13}' for name in peers))
    for size in options.sizes:
        made = {
            name: (make(size), random_actions(name, size)) for name, make in peers.items()
            if size <= _LARGEST.get(name, size)}
        for step, actions in made.values():
            rate(step, actions, 0.2 * options.seconds)
        samples: dict[str, list[float]] = {name: [] for name in made}
        for _ in range(options.rounds):
            for name, (step, actions) in made.items():
                samples[name].append(rate(step, actions, options.seconds))
        for name, rates in samples.items():
            table[name][size] = statistics.median(rates)
        print(f'{size:>6}' + ''.join(
            f'{table[name][size]:>13,.0f}' if size in table[name] else f'{"":>13}'
            for name in peers), flush=True)
    best = {name: max(rates.values()) for name, rates in table.items()}
    print('  best' + ''.join(f'{best[name]:>13,.0f}' for name in peers))
    ratios = {
        world: {name: best[world] / best[name] for name in peers if name not in OUR_WORLDS}
        for world in OUR_WORLDS}
    for world, found in ratios.items():
        print(f'{world} is ' + ', '.join(f'{r:.1f} x {name}' for name, r in found.items()))
    if options.output:
        write_json(
            options.output, {'steps_per_second': table, 'best': best, 'ratios': ratios})


if __name__ == '__main__':
    main()
