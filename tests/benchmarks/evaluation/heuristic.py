# SPDX-License-Identifier: Apache-2.0
"""Compares the returns of Gymnasium's heuristic pilot in our `lunar_lander` and in Gymnasium's."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.evaluation import gymnasium_lander
from benchmarks.evaluation.intervals import difference
from benchmarks.evaluation.intervals import mean_line
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node import worlds

PUBLISHED = {'discrete': '237 ± 106', 'continuous': '284 ± 19'}
"""EnvPool's means for this pilot, from its alignment tests"""


def compare(episodes: int, seed: int, continuous: bool) -> dict[str, Any]:
    """Fly the pilot in both worlds and return the figures."""
    world = worlds.make('lunar_lander', num_envs=20, seed=seed, continuous=continuous)
    pilot = LunarHeuristic(world.spec)
    ours = evaluate(world, pilot, episodes, seed).episodes
    theirs = gymnasium_lander.fly(pilot, episodes, seed, continuous)
    change, low, high = difference(ours.episode_return, theirs.episode_return)
    return {
        'action': 'continuous' if continuous else 'discrete', 'episodes': episodes,
        'ours': ours.episode_return, 'theirs': theirs.episode_return,
        'our_length': float(ours.length.mean()), 'their_length': float(theirs.length.mean()),
        'our_outcomes': {
            name: int((ours.outcome == code).sum())
            for code, name in enumerate(world.spec.outcomes)},
        'their_outcomes': theirs.outcomes,
        'difference': change, 'difference_interval': [low, high],
    }


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench heuristic', description=__doc__)
    parser.add_argument(
        '--episodes', type=int, default=200, help='episodes for each world and kind of action')
    parser.add_argument('--seed', type=int, default=0, help='seed')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    results = [compare(options.episodes, options.seed, kind) for kind in (False, True)]
    print(f'The heuristic pilot, {options.episodes} episodes each: mean return ± deviation')
    print(f'{"action":<12}{"ours":>16}{"Gymnasium":>18}{"ours - Gymnasium":>28}'
          f'{"published":>14}{"mean length":>16}')
    for result in results:
        low, high = result['difference_interval']
        print(
            f'{result["action"]:<12}{mean_line(result["ours"]):>16}'
            f'{mean_line(result["theirs"]):>18}'
            f'{result["difference"]:>+10.1f}  [{low:+.1f}, {high:+.1f}]'.ljust(74)
            + f'{PUBLISHED[result["action"]]:>14}'
            f'{result["our_length"]:>9.0f} {result["their_length"]:.0f}')
        print(f'{"":<12}ours {result["our_outcomes"]}, Gymnasium {result["their_outcomes"]}')
    if options.output:
        for result in results:
            for side in ('ours', 'theirs'):
                values: np.ndarray = result.pop(side)
                result[side] = {'mean': float(values.mean()), 'std': float(values.std(ddof=1))}
        write_json(options.output, {'heuristic': results})


if __name__ == '__main__':
    main()
