# SPDX-License-Identifier: Apache-2.0
"""Whether a world that is stepped by two threads is faster than by one, on two cores.

Two worlds of half the size stand for a world in two slices: they share nothing, so no scheme of
threads within a world can gain more. They are stepped one after the other and by two threads, one
each; one whole world is stepped beside them. All are measured alternately, step by step. Of the
times of a step, the median is reported and the 5 % quantile, as other load slows two threads more
than one.
"""
from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stepping import random_actions
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import worlds

CASES = (('lunar_lander', 256), ('lunar_lander', 1024), ('lunar_lander', 4096),
         ('rocket', 1024), ('rocket', 4096), ('rocket', 16_384))
_WARM_UP = 20
"""steps that are not counted"""
WAYS = ('whole', 'halves', 'threads')
Step = Callable[[int], Any]


def ways(world: str, size: int, pool: ThreadPoolExecutor) -> dict[str, Step]:
    """Return how to step, by name; each takes the number of the batch of actions."""
    settings = {'level': 7} if world == 'rocket' else {}
    actions = random_actions(world, size)
    whole = worlds.make(world, size, 1, **settings)
    halves = [[worlds.make(world, size // 2, seed, **settings) for seed in (1, 2)]
              for _ in range(2)]
    parts = [actions[:, :size // 2], actions[:, size // 2:]]

    def one(number: int) -> None:
        whole.step(actions[number])

    def both(number: int) -> None:
        for half, part in zip(halves[0], parts, strict=True):
            half.step(part[number])

    def threads(number: int) -> None:
        # One half in this thread, as a pool would do it too.
        other = pool.submit(halves[1][1].step, parts[1][number])
        halves[1][0].step(parts[0][number])
        other.result()

    return dict(zip(WAYS, (one, both, threads), strict=True))


def main() -> None:
    """Print the table, write the figures."""
    parser = argparse.ArgumentParser(prog='bench threads', description=__doc__.split('\n')[0])
    parser.add_argument('--steps', type=int, default=400, help='number of steps of each way')
    parser.add_argument('--worlds', nargs='+', choices=('lunar_lander', 'rocket'),
                        default=['lunar_lander', 'rocket'], help='worlds')
    parser.add_argument('--sizes', type=int, nargs='+', help='batch sizes')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, cores)
    cases = [(world, size) for world, size in CASES if world in options.worlds]
    if options.sizes:
        cases = [(world, size) for world in options.worlds for size in options.sizes]
    print(f'ms of a step on {len(cores)} cores, median (5 % quantile) of {options.steps} steps')
    print(f'{"":<14}{"batch":>7}{"one world":>20}{"two halves":>20}{"in two threads":>20}'
          f'{"halves / threads":>18}{"one / threads":>15}')
    figures = []
    with ThreadPoolExecutor(1) as pool:
        for world, size in cases:
            steps = ways(world, size, pool)
            times: dict[str, list[float]] = {name: [] for name in WAYS}
            for number in range(options.steps + _WARM_UP):
                for name, step in steps.items():
                    began = time.perf_counter()
                    step(number % 16)
                    times[name].append(1e3 * (time.perf_counter() - began))
            median = {name: statistics.median(each[_WARM_UP:]) for name, each in times.items()}
            fast = {name: float(np.quantile(each[_WARM_UP:], 0.05))
                    for name, each in times.items()}
            row = {'world': world, 'size': size, 'median': median, 'fast': fast,
                   'gain_over_halves': fast['halves'] / fast['threads'],
                   'gain_over_whole': fast['whole'] / fast['threads']}
            figures.append(row)
            print(f'{world:<14}{size:>7}' + ''.join(
                f'{median[name]:.3f} ({fast[name]:.3f})'.rjust(20) for name in WAYS)
                + f'{row["gain_over_halves"]:>18.2f}{row["gain_over_whole"]:>15.2f}', flush=True)
    if options.output:
        write_json(options.output, {'threads': figures})


if __name__ == '__main__':
    main()
