# SPDX-License-Identifier: Apache-2.0
"""Tunes the gains of a scripted rocket pilot under conditions with CMA-ES, and evaluates them."""
from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from cmaes import CMA

from benchmarks import machine
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.evaluation.tuning import Gains
from ppo_agent_node.evaluation.tuning import GainSpace
from ppo_agent_node.evaluation.tuning import Generation
from ppo_agent_node.evaluation.tuning import Task
from ppo_agent_node.evaluation.tuning import judge
from ppo_agent_node.evaluation.tuning import search
from ppo_agent_node.pilots.scripted import ROCKET_PILOTS
from ppo_agent_node.statistics import mean_interval
from ppo_agent_node.statistics import wilson
from rocket_sim_node import worlds
from rocket_sim_node.settings import describe


def searched(pilot: str) -> list[str]:
    """Return the gains that are tuned by default: all whose default is above 0."""
    infos = describe(ROCKET_PILOTS[pilot].settings_class)
    return [info.name for info in infos if isinstance(info.default, float) and info.default > 0]


def tune(options: argparse.Namespace, names: list[str], start: Gains) -> list[Generation]:
    """Search for the given time and return all generations."""
    pilot = ROCKET_PILOTS[options.pilot]
    space = GainSpace(pilot.settings_class, names, start)
    tasks = [
        Task(worlds.make(options.world, options.starts, conditions=options.conditions), level,
             options.seed + number, weight)
        for number, (level, weight) in enumerate(
            zip(options.levels, options.weights, strict=True))]
    optimiser = CMA(
        mean=space.origin, sigma=options.sigma, seed=options.seed,
        population_size=options.population)
    began, found = time.process_time(), []
    worth = judge(tasks, lambda spec, gains: pilot(spec, **gains))
    for generation in search(space, worth, optimiser):
        found.append(generation)
        elapsed = time.process_time() - began
        print(f'{elapsed:6.0f} s, {generation.flown} candidates: median '
              f'{generation.median_return:.3f}, best {generation.best_return:.3f}', flush=True)
        if elapsed > options.seconds:
            return found
    return found


def check(options: argparse.Namespace, level: int, gains: Gains) -> dict[str, Any]:
    """Return the figures of the given gains on fresh starts of a level."""
    world = worlds.make(options.world, options.check, conditions=options.conditions)
    pilot = ROCKET_PILOTS[options.pilot](world.spec, **gains)
    episodes = evaluate(world, pilot, options.check, options.check_seed, level=level).episodes
    landed = int((episodes.outcome == 0).sum())
    return {
        'landed': landed, 'landed_interval': wilson(landed, options.check),
        'mean_return': float(episodes.episode_return.mean()),
        'mean_return_interval': mean_interval(episodes.episode_return)}


def draw(path: Path, found: list[Generation]) -> None:
    """Plot the return of each generation against the number of candidates flown."""
    figure, axes = plt.subplots(figsize=(6, 3.5), layout='constrained')
    flown = [generation.flown for generation in found]
    axes.plot(flown, [generation.median_return for generation in found], label='median')
    axes.plot(flown, [generation.best_return for generation in found], label='best so far')
    low = sorted(generation.median_return for generation in found)[len(found) // 4]
    axes.set(xlabel='candidates flown', ylabel='mean return', ylim=(low - 1, None))
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Tune the gains, check them on fresh starts, and print and write the figures."""
    parser = argparse.ArgumentParser(prog='bench tune', description=__doc__)
    parser.add_argument('--world', default='rocket', help='world')
    parser.add_argument('--conditions', default='nominal', help='set of conditions')
    parser.add_argument(
        '--pilot', default='expert', choices=sorted(ROCKET_PILOTS), help='pilot to tune')
    parser.add_argument('--levels', type=int, nargs='+', default=[7, 8], help='levels')
    parser.add_argument('--weights', type=float, nargs='+', default=[1.0, 0.2],
                        help='weights of the levels in the score')
    parser.add_argument('--starts', type=int, default=512, help='starts per candidate and level')
    parser.add_argument('--seconds', type=float, default=240, help='processor time, s')
    parser.add_argument('--seed', type=int, default=1000, help='seed of the starts for tuning')
    parser.add_argument(
        '--sigma', type=float, default=0.15,
        help='initial standard deviation of the logarithms of gains')
    parser.add_argument('--population', type=int, default=12, help='population size of CMA-ES')
    parser.add_argument('--gains', nargs='+', help='gains to tune; by default all')
    parser.add_argument('--start', nargs='+', default=[], metavar='GAIN=VALUE',
                        help='initial values of gains')
    parser.add_argument(
        '--check', type=int, default=10_000, help='number of fresh starts for the check')
    parser.add_argument('--check-seed', type=int, default=20_000_000,
                        help='seed of the fresh starts')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    start = {name: float(value) for name, value in (a.split('=') for a in options.start)}
    began = time.process_time()
    found = tune(options, options.gains or searched(options.pilot), start)
    seconds = time.process_time() - began
    tuned = found[-1].centre
    print(' '.join(f'{name}={value:.4g}' for name, value in tuned.items()))
    checks: dict[str, Any] = {}
    for level in options.levels:
        for name, gains in (('start', start), ('tuned', tuned)):
            one = checks[f'level_{level}_{name}'] = check(options, level, gains)
            low, high = one['mean_return_interval']
            print(f'level {level}, {name}: landed {one["landed"]} of {options.check}, '
                  f'return {one["mean_return"]:.3f} [{low:.3f}, {high:.3f}]', flush=True)
    if options.output:
        draw(options.output.with_suffix('.png'), found)
        write_json(options.output, {
            'pilot': options.pilot, 'gains': tuned, 'commit': machine.commit(), 'options': {
                name: str(value) if isinstance(value, Path) else value
                for name, value in vars(options).items()},
            'seconds': seconds, 'checks': checks,
            'generations': [asdict(generation) for generation in found]})


if __name__ == '__main__':
    main()
