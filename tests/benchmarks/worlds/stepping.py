# SPDX-License-Identifier: Apache-2.0
"""Steps per second of `lunar_lander`, `rocket`, EnvPool and Gymnasium on one core.

Random actions, episodes and resets are included. The peers and this project are measured
alternately in several rounds, so that disturbances affect all of them. Medians are reported.

A second table shows what limits small batches: the time of a step, the part of it that pymunk's
own calls take (set forces, step, read bodies and contacts), and the time of the smallest operation
of NumPy, of which a step makes the same number for any batch.
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
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld

SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16_384)
_LARGEST = {'lunar_lander': 4096, 'EnvPool': 4096, 'Gymnasium': 64}
"""maximum number of environments; more are not faster (Gymnasium's vector is a loop)"""

OUR_WORLDS = ('lunar_lander', 'rocket')
_FEW = 64
"""largest batch of the table of limits"""
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


def pymunk_share(num_envs: int, seconds: float) -> float:
    """Return the part of a lander's step that pymunk's own calls take."""
    world = LunarLanderWorld(num_envs, seed=1)
    share = world._lanes._shares[0]
    spent, step = 0.0, share.step

    def timed(dt: float) -> None:
        nonlocal spent
        start = time.perf_counter()
        step(dt)
        spent += time.perf_counter() - start

    share.step = timed  # type: ignore[method-assign]
    actions = random_actions('lunar_lander', num_envs)
    rate(world.step, actions, 0.2 * seconds)
    spent, start = 0.0, time.perf_counter()
    rate(world.step, actions, seconds)
    return spent / (time.perf_counter() - start)


def smallest_operation(seconds: float) -> float:
    """Return the seconds that NumPy takes to add two arrays of one number."""
    one, other, total = np.ones(1), np.ones(1), np.ones(1)
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        for _ in range(1000):
            np.add(one, other, out=total)
        count += 1000
    return elapsed / count


def limits(
    table: dict[str, dict[int, float]], rounds: int, seconds: float,
) -> dict[str, Any]:
    """Return and print what limits small batches: microseconds of a step, and of its parts."""
    sizes = [size for size in table['lunar_lander'] if size <= _FEW]
    names = [name for name in ('lunar_lander', 'rocket', 'EnvPool') if name in table]
    found: dict[str, Any] = {
        'sizes': sizes,
        'step': {name: [1e6 * n / table[name][n] for n in sizes] for name in names},
        'pymunk_share': [
            statistics.median(pymunk_share(n, seconds) for _ in range(rounds)) for n in sizes],
        'operation': 1e6 * statistics.median(smallest_operation(seconds) for _ in range(rounds))}
    print('\nus of a step of a small batch; pymunk: its own calls in a step of lunar_lander')
    print(f'{"batch":>6}' + ''.join(f'{name:>13}' for name in (*names, 'pymunk')))
    for k, size in enumerate(sizes):
        step = [found['step'][name][k] for name in names]
        print(f'{size:>6}' + ''.join(
            f'{value:>13,.1f}' for value in (*step, step[0] * found['pymunk_share'][k])))
    print(f'the smallest operation of NumPy takes {found["operation"]:.2f} us')
    return found


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
    small = limits(table, options.rounds, options.seconds)
    if options.output:
        write_json(options.output, {
            'steps_per_second': table, 'best': best, 'ratios': ratios, 'limits': small})


if __name__ == '__main__':
    main()
