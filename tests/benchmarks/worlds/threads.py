# SPDX-License-Identifier: Apache-2.0
"""Speed-up of stepping a world by several threads instead of one.

`lunar_lander` has the setting `step_threads`. `rocket` does not: it is one batch in NumPy, and
slices would make its calls shorter but not fewer. Smaller worlds that share nothing, each stepped
by one thread, show the upper bound of the gain by slices. All are measured alternately, step by
step. The median time of a step and its 5 % quantile are reported, because other load slows several
threads more than one.
"""
from __future__ import annotations

import argparse
import itertools
import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.worlds.stepping import random_actions
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import worlds

CASES = (('lunar_lander', 256), ('lunar_lander', 1024), ('lunar_lander', 4096),
         ('rocket', 1024), ('rocket', 4096), ('rocket', 16_384))
_WARM_UP = 20
"""steps that are not counted"""
Step = Callable[[int], Any]


def ways(world: str, size: int, threads: int, pool: ThreadPoolExecutor) -> tuple[Step, Step]:
    """Return functions that step with one and several threads, given the index of the actions."""
    settings = {'level': 7} if world == 'rocket' else {}
    actions = random_actions(world, size)
    whole = worlds.make(world, size, 1, **settings)

    def one(number: int) -> None:
        whole.step(actions[number])

    if world == 'lunar_lander':
        shared = worlds.make(world, size, 1, threads, **settings)
        return one, lambda number: shared.step(actions[number])
    cuts = [size * k // threads for k in range(threads + 1)]
    parts = [(worlds.make(world, end - first, 1, **settings), actions[:, first:end])
             for first, end in itertools.pairwise(cuts)]

    def several(number: int) -> None:
        # This thread steps the first part, as it would inside a world.
        others = [pool.submit(part.step, its[number]) for part, its in parts[1:]]
        parts[0][0].step(parts[0][1][number])
        for other in others:
            other.result()

    return one, several


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench threads', description=__doc__.split('\n')[0])
    parser.add_argument('--steps', type=int, default=400, help='number of steps of each way')
    parser.add_argument('--worlds', nargs='+', choices=('lunar_lander', 'rocket'),
                        default=['lunar_lander', 'rocket'], help='worlds')
    parser.add_argument('--sizes', type=int, nargs='+', help='batch sizes')
    parser.add_argument('--threads', type=int, default=2, help='number of threads, and of cores')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))[:options.threads]
    os.sched_setaffinity(0, cores)
    cases = [(world, size) for world, size in CASES if world in options.worlds]
    if options.sizes:
        cases = [(world, size) for world in options.worlds for size in options.sizes]
    print(f'ms of a step on {len(cores)} cores, median (5 % quantile) of {options.steps} steps')
    print(f'{"":<14}{"batch":>7}{"one thread":>20}{f"{options.threads} threads":>20}'
          f'{"times as fast":>15}')
    figures = []
    with ThreadPoolExecutor(max(1, options.threads - 1)) as pool:
        for world, size in cases:
            times: tuple[list[float], list[float]] = ([], [])
            steps = ways(world, size, options.threads, pool)
            for number in range(options.steps + _WARM_UP):
                for step, each in zip(steps, times, strict=True):
                    began = time.perf_counter()
                    step(number % 16)
                    each.append(1e3 * (time.perf_counter() - began))
            median = [statistics.median(each[_WARM_UP:]) for each in times]
            fast = [float(np.quantile(each[_WARM_UP:], 0.05)) for each in times]
            gain = fast[0] / fast[1]
            figures.append({'world': world, 'size': size, 'threads': options.threads,
                            'median': median, 'fast': fast, 'gain': gain})
            print(f'{world:<14}{size:>7}' + ''.join(
                f'{m:.3f} ({f:.3f})'.rjust(20) for m, f in zip(median, fast, strict=True))
                + f'{gain:>15.2f}', flush=True)
    if options.output:
        write_json(options.output, {'threads': figures})


if __name__ == '__main__':
    main()
