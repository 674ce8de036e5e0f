# SPDX-License-Identifier: Apache-2.0
"""Least fuel and time from starts of world `rocket`, with accuracy and speed of the solver."""
from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.optimum.fuel_bounds import StraightDropBound
from ppo_agent_node.evaluation.optimum.optimiser import BLOCKS
from ppo_agent_node.evaluation.optimum.optimiser import LandingOptimiser
from ppo_agent_node.evaluation.optimum_sample import return_ceiling
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket.world import RocketWorld


def solve(world: RocketWorld, blocks: int) -> tuple[F64, F64, F64, float]:
    """Return least fuel (kg), least steps and miss (m) of each start, and CPU time (s)."""
    optimiser = LandingOptimiser(world.spec.settings, blocks)
    found = []
    start = time.process_time()
    for position, velocity in zip(world.position.T, world.velocity.T, strict=True):
        best = optimiser.solve(position, velocity)
        found.append((np.nan,) * 3 if best is None else (
            best.least_fuel.fuel, best.least_time.steps,
            np.linalg.norm(best.least_fuel.position[-1]
                           - (0.0, world.settings.touchdown_height, 0.0))))
    fuel, steps, miss = np.array(found, np.float64).T
    return fuel, steps, miss, time.process_time() - start


def main() -> None:
    """Solve the starts of each level, print the means and write the figures."""
    parser = argparse.ArgumentParser(prog='bench optimum', description=__doc__)
    parser.add_argument('--starts', type=int, default=100, help='starts of each level')
    parser.add_argument('--levels', type=int, nargs='+', default=[1, 7, 8], help='levels')
    parser.add_argument(
        '--seed', type=int, default=20_000_000, help='seed of the starts, never used in training')
    parser.add_argument(
        '--fine', type=int, default=6,
        help='number of starts that are also solved with --blocks blocks')
    parser.add_argument(
        '--blocks', type=int, default=240, help='blocks of steps of the fine solution')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    figures = {}
    for level in options.levels:
        world = worlds.make('rocket', options.starts, options.seed, level=level)
        assert isinstance(world, RocketWorld)
        fuel, steps, miss, seconds = solve(world, BLOCKS)
        drop = StraightDropBound(world.spec.settings).fuel(world.velocity[1])
        few = worlds.make('rocket', options.fine, options.seed, level=level)
        assert isinstance(few, RocketWorld)
        fine, fine_steps, _, _ = solve(few, options.blocks)
        coarser = fuel[:options.fine] - fine
        figures[f'level_{level}'] = one = {
            'solved': int(np.isfinite(fuel).sum()), 'fuel_kg': float(np.nanmean(fuel)),
            'straight_drop_kg': float(drop.mean()),
            'over_straight_drop_kg': [float(np.nanmin(fuel - drop)),
                                      float(np.nanmax(fuel - drop))],
            'steps': float(np.nanmean(steps)),
            'return_ceiling': float(np.nanmean(return_ceiling(world.spec.settings, steps))),
            'miss_m': float(np.nanmax(miss)),
            'blocks_cost_kg': [float(np.nanmean(coarser)), float(np.nanmax(coarser))],
            'blocks_cost_steps': float(np.nanmax(steps[:options.fine] - fine_steps)),
            'starts_per_cpu_second': options.starts / seconds}
        print(
            f'level {level}, seed {options.seed}: {one["solved"]} of {options.starts} solved\n'
            f'  least fuel {one["fuel_kg"]:.1f} kg, {np.nanmin(fuel - drop):.1f} to '
            f'{np.nanmax(fuel - drop):.1f} kg above the {one["straight_drop_kg"]:.1f} kg of a '
            'straight drop\n'
            f'  least time {one["steps"]:.1f} steps, return at most {one["return_ceiling"]:.3f}\n'
            f'  {BLOCKS} blocks cost {np.nanmean(coarser):.3f} kg, at most '
            f'{np.nanmax(coarser):.3f} kg and {one["blocks_cost_steps"]:.0f} steps, against '
            f'{options.blocks} ({options.fine} starts)\n'
            f'  flown it ends at most {1000 * np.nanmax(miss):.2f} mm from the pad\n'
            f'  {one["starts_per_cpu_second"]:.1f} starts per second of processor time',
            flush=True)
    if options.output:
        write_json(options.output, figures)


if __name__ == '__main__':
    main()
