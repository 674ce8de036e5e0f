# SPDX-License-Identifier: Apache-2.0
"""Comparison of an evaluation's first episodes with their optimum."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppo_agent_node.evaluation.averages import mean
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.starts import start_height
from rocket_sim_node.worlds.base import F64

SAMPLE = 12
"""Default number of solved starts."""


@dataclass(frozen=True)
class OptimumSample:
    """The optimum of the first J episodes of an evaluation."""

    fuel: F64
    """`(J,)` kg, minimum fuel; NaN if a start was not solved."""
    steps: F64
    """`(J,)` minimum length of the episode; NaN if a start was not solved."""
    ceiling: F64
    """`(J,)` upper bound of the return; NaN if a start was not solved."""
    reason: str = ''
    """Why nothing was solved, '' if something was."""

    def figures(self, result: EvaluationResult) -> dict[str, Any]:
        """Return the figures for `evaluation.json`, null if there is no value.

        - `fuel_optimum_kg`, `time_optimum_s`, `return_ceiling`: means over the solved starts;
        - `fuel_ratio_optimum`: the mean of fuel used over minimum fuel, of landed episodes;
        - `optimum_sample`: number of solved starts, `optimum_reason`: why there are none.
        """
        solved = np.isfinite(self.fuel)
        ratio = (result.episodes.fuel_used[:len(solved)] / self.fuel)[
            solved & result.landed[:len(solved)]]
        time = self.steps * result.spec.dt
        return {
            'fuel_optimum_kg': mean(self.fuel), 'time_optimum_s': mean(time),
            'return_ceiling': mean(self.ceiling), 'fuel_ratio_optimum': mean(ratio),
            'optimum_sample': int(solved.sum()), 'optimum_reason': self.reason or None}


def solve_sample(result: EvaluationResult, sample: int = SAMPLE) -> OptimumSample:
    """Return the optimum of the first episodes of an evaluation, in order of its rows.

    :param sample: number of episodes; 0: none.
    """
    reason = _why_not(result, sample)
    if reason:
        nothing = np.zeros(0)
        return OptimumSample(nothing, nothing, nothing, reason)
    # Imported here: without the solver's library, an evaluation only lacks the optimum.
    from ppo_agent_node.evaluation.optimum.optimiser import LandingOptimiser

    settings = result.settings
    try:
        optimiser = LandingOptimiser(settings)
    except ValueError as error:
        nothing = np.zeros(0)
        return OptimumSample(nothing, nothing, nothing, str(error))
    position, velocity = starts(result, sample)
    fuel, steps = np.full((2, len(position)), np.nan)
    for row in np.flatnonzero(np.isfinite(position + velocity).all(1)):
        optimum = optimiser.solve(position[row], velocity[row])
        if optimum is not None:
            fuel[row] = optimum.least_fuel.fuel
            steps[row] = optimum.least_time.steps + _steps_at_rest(settings)
    return OptimumSample(
        fuel, steps, return_ceiling(settings, steps),
        '' if np.isfinite(fuel).any() else 'no start of the sample can be landed from')


def starts(result: EvaluationResult, sample: int) -> tuple[F64, F64]:
    """Return position, m, and velocity, m/s, `(J, 3)` of the first episodes' starts, y up.

    NaN if an observation was clipped and is therefore ambiguous.
    """
    settings, names = result.settings, result.spec.observation_names
    seen = result.first_observation[:sample].astype(np.float64)
    seen[np.abs(seen) >= settings['observation_limit']] = np.nan
    position, velocity = (
        settings[f'{what}_scale'] * seen[:, [names.index(f'{what}_{axis}') for axis in 'xyz']]
        for what in ('position', 'velocity'))
    position[:, 1] = start_height(seen[:, names.index('position_y')], settings)
    return position, velocity


def return_ceiling(settings: Mapping[str, float], steps: F64) -> F64:
    """Return the return of a landing in `steps` steps at no speed, tilt and distance.

    It is an upper bound if steps cost and a softer landing is worth more: a second costs 0.5 by
    default, 1 m/s at touchdown 33, so haste does not pay. NaN if steps are rewarded.
    """
    landing = sum(settings[f'reward_{what}'] for what in ('landed', 'speed', 'tilt', 'distance'))
    if settings['reward_step'] > 0:
        return np.full_like(steps, np.nan)
    return landing + settings['reward_step'] * steps


def _why_not(result: EvaluationResult, sample: int) -> str:
    """Return why no optimum can be computed, '' if it can."""
    if not sample:
        return 'not asked for'
    if not result.is_rocket:
        return f'world {result.spec.name} burns no fuel'
    try:
        import clarabel  # noqa: F401  (checks that it is installed)
    except ImportError:
        return 'the library clarabel is missing: pip install clarabel==0.11.1'
    return ''


def _steps_at_rest(settings: Mapping[str, float]) -> int:
    """Return how many steps a vehicle must stand still before the world counts it as landed."""
    if 'rest_time' not in settings:
        return 0
    return max(1, int(np.ceil(settings['rest_time'] / settings['dt'] - 1e-9)))
