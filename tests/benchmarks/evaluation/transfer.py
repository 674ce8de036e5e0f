# SPDX-License-Identifier: Apache-2.0
"""Flies a policy trained in our `lunar_lander` in Gymnasium's LunarLander, unchanged."""
from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.evaluation import gymnasium_lander
from benchmarks.evaluation.intervals import difference
from benchmarks.evaluation.intervals import mean_line
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node import worlds

SOLVED = 200.0
"""Return from which an episode counts as solved, as in Gymnasium's documentation."""


def main() -> None:
    """Fly the policy in both worlds, print the means and write the figures."""
    parser = argparse.ArgumentParser(prog='bench transfer', description=__doc__)
    parser.add_argument('--policy', default='', help='policy file; by default the newest')
    parser.add_argument('--episodes', type=int, default=500, help='episodes in each world')
    parser.add_argument(
        '--seed', type=int, default=20_000_000, help='seed of the starts, never used in training')
    parser.add_argument(
        '--continuous', action='store_true', help='for policies with the two continuous actions')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    path = find_policy(options.policy, 'lunar_lander')
    world = worlds.make('lunar_lander', num_envs=20, continuous=options.continuous)
    pilot = PolicyPilot(path, world.spec)
    ours = evaluate(world, pilot, options.episodes, options.seed).episodes
    theirs = gymnasium_lander.fly(pilot, options.episodes, options.seed, options.continuous)
    change, low, high = difference(ours.episode_return, theirs.episode_return)
    print(f'{path}, {options.episodes} deterministic episodes each: mean return ± deviation')
    solved = [float((one.episode_return >= SOLVED).mean()) for one in (ours, theirs)]
    print(f'our lunar_lander           {mean_line(ours.episode_return)}, '
          f'solved {100 * solved[0]:.2f} %')
    print(f"Gymnasium's {gymnasium_lander.NAME} {mean_line(theirs.episode_return)}, "
          f'solved {100 * solved[1]:.2f} %')
    print(f'ours - Gymnasium           {change:+7.1f}  [{low:+.1f}, {high:+.1f}]')
    print(f'Gymnasium: {theirs.outcomes}')
    if options.output:
        write_json(options.output, {
            'policy': str(path), 'episodes': options.episodes, 'seed': options.seed,
            'ours': float(ours.episode_return.mean()),
            'gymnasium': float(theirs.episode_return.mean()),
            'solved': solved[0], 'gymnasium_solved': solved[1],
            'difference': change, 'difference_interval': [low, high],
            'gymnasium_outcomes': theirs.outcomes,
        })


if __name__ == '__main__':
    main()
