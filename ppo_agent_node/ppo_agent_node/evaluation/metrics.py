# SPDX-License-Identifier: Apache-2.0
"""Metrics of an evaluation: a dictionary for the file, a table for the terminal."""
from __future__ import annotations

import json
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.evaluation import failures
from ppo_agent_node.evaluation import flying_quality
from ppo_agent_node.evaluation.averages import mean
from ppo_agent_node.evaluation.averages import spread
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.statistics import mean_interval
from ppo_agent_node.statistics import wilson
from rocket_sim_node.worlds.rocket import conditions

UNITS = {
    'touchdown_speed': 'm/s', 'tilt': 'deg', 'distance': 'm', 'fuel_used_kg': 'kg',
    'fuel_bound_kg': 'kg', 'mean_length': 'steps', 'rest_distance': 'm', 'hover_time': 's',
    'fuel_optimum_kg': 'kg', 'time_optimum_s': 's',
}


def summarise(result: EvaluationResult, **extra: Any) -> dict[str, Any]:
    """Return the metrics of an evaluation, ready for JSON: null if there is no value.

    - `landing_rate` with `landing_rate_interval`, Wilson, 95 %;
    - `mean_return` with `mean_return_interval`, 95 % (see `statistics.mean_interval`),
      `return_std` and `return_p05`, the 5th percentile;
    - `mean_return_landed`, `mean_return_standing`, `mean_return_tanks_dry`: the mean return of
      the episodes counted by each of these rates;
    - `touchdown_speed` (m/s), `tilt` (deg from vertical), `distance` (m from the pad's centre),
      over the episodes that touched down, `fuel_used_kg` over all: each `mean` and `p95`, the
      95th percentile;
    - `fuel_bound_kg`, the mean minimum fuel of straight drops from the same starts, and
      `fuel_ratio`, the mean of used / minimum, both over landed episodes;
    - `standing_rate` with `standing_rate_interval`, Wilson, 95 %: the rate of rockets that stand
      after their touchdown, by the contact model that continues world `rocket`; equal to landed in
      `rocket_planar`; null elsewhere. `settling`, touchdowns by verdict, and `rest_distance` (m)
      of standing rockets: world `rocket` only;
    - `conditions`, the name of the set that was flown, `custom` for one without a name, null in
      worlds without rockets;
    - `tanks_dry` with `tanks_dry_interval`, Wilson, 95 %: the rate of episodes that ended with an
      empty tank; `hover_time` (s), `ignitions` of the engine, `control_effort` (change of the
      throttle and size of both torques per step, see `Episodes`): each `mean` and `p95`. Rockets
      only, null elsewhere;
    - `mean_length` in steps; `outcomes`, episodes by name, zeros included; `units`;
    - `failed_starts`: up to twelve failed episodes, by `row`, `episode`, `outcome` and `return`,
      the outcomes in turn; with the seed and the settings they can be flown again;
    - `world_settings`, the world's settings during the evaluation.

    :param extra: further facts to store, such as the hash of the policy.
    :raises ValueError: for an extra that would overwrite a metric.
    """
    episodes, landed = result.episodes, result.landed
    ground = result.ground
    level = result.settings.get('level')
    summary: dict[str, Any] = {
        'world': result.spec.name,
        'level': None if level is None else int(level),
        'conditions': conditions.name_of(result.settings) if result.is_rocket else None,
        'policy': result.pilot,
        'seed': result.seed,
        'num_envs': result.spec.num_envs,
        'reset_settings': result.reset_settings,
        **success(result),
        'touchdown_speed': spread(episodes.touchdown_speed[ground]),
        'tilt': spread(np.rad2deg(episodes.tilt[ground])),
        'distance': spread(episodes.distance[ground]),
        'fuel_used_kg': spread(episodes.fuel_used if result.is_rocket else np.zeros(0)),
        'fuel_bound_kg': mean(result.fuel_bound[landed]),
        'fuel_ratio': fuel_ratio(result),
        'mean_length': float(episodes.length.mean()),
        'outcomes': outcomes(result),
        'units': UNITS,
        'world_settings': result.settings,
    }
    summary |= _standing(result) | flying_quality.figures(result)
    summary['failed_starts'] = failures.failed_starts(result)
    clash = sorted(set(extra) & set(summary))
    if clash:
        raise ValueError(f'{", ".join(clash)}: reserved for the figures')
    return {**summary, **extra}


def success(result: EvaluationResult) -> dict[str, Any]:
    """Return landing rate and mean return, each with its interval."""
    returns, landed = result.episodes.episode_return, result.landed
    count, successes = len(landed), int(landed.sum())
    return {
        'episodes': count,
        'landed': successes,
        'landing_rate': successes / count,
        'landing_rate_interval': list(wilson(successes, count)),
        'mean_return': float(returns.mean()),
        'mean_return_interval': list(mean_interval(returns)),
        'mean_return_landed': mean(returns[landed]),
        'return_std': float(returns.std()),
        'return_p05': float(np.quantile(returns, 0.05)),
    }


def fuel_ratio(result: EvaluationResult) -> float | None:
    """Return the mean of fuel used / minimum fuel of a straight drop, over landed episodes."""
    landed = result.landed
    return mean(result.episodes.fuel_used[landed] / result.fuel_bound[landed])


def outcomes(result: EvaluationResult) -> dict[str, int]:
    """Return the number of episodes with each outcome, zeros included."""
    return {name: int((result.episodes.outcome == code).sum())
            for code, name in enumerate(result.spec.outcomes)}


def _standing(result: EvaluationResult) -> dict[str, Any]:
    """Return the metrics of the motion after touchdown."""
    standing, settled = result.standing, result.settled
    if standing is None:
        return {'standing_rate': None, 'standing_rate_interval': None,
                'mean_return_standing': None}
    count = int(standing.sum())
    more = {} if settled is None else {
        'settling': settled.verdicts, 'rest_distance': spread(settled.rest_distance)}
    return {
        'standing_rate': count / len(standing),
        'standing_rate_interval': list(wilson(count, len(standing))),
        'mean_return_standing': mean(result.episodes.episode_return[standing]), **more}


def table(summary: Mapping[str, Any]) -> str:
    """Return the metrics as aligned text for a terminal."""
    low, high = (100 * bound for bound in summary['landing_rate_interval'])
    least, most = summary['mean_return_interval']
    level = '' if summary['level'] is None else f', level {summary["level"]}'
    flown = summary['conditions']
    under = '' if flown in (None, 'nominal') else f', conditions {flown}'
    rows = [
        ('world', f'{summary["world"]}{level}{under}'),
        ('policy', str(summary['policy'])),
        ('episodes', f'{summary["episodes"]} (seed {summary["seed"]})'),
        ('landed', f'{100 * summary["landing_rate"]:.2f} %  [{low:.2f}, {high:.2f}]'),
        ('return', f'{summary["mean_return"]:.2f}  [{least:.2f}, {most:.2f}]'
                   f'{_landed_return(summary)}'),
        ('length', f'{summary["mean_length"]:.1f} steps'),
    ]
    for name, unit in (('touchdown_speed', 'm/s'), ('tilt', 'deg'), ('distance', 'm'),
                       ('fuel_used_kg', 'kg')):
        if summary[name]['mean'] is not None:
            label = name.removesuffix('_kg').replace('_', ' ')
            if summary['tanks_dry'] is None:
                # Not a rocket: speed, tilt and distance are not recorded at touchdown.
                label = label.replace('touchdown speed', 'speed at the end')
            rows.append((
                label,
                f'{summary[name]["mean"]:.4g} {unit}  (95 %: below {summary[name]["p95"]:.4g})'))
    if summary['standing_rate'] is not None:
        low, high = (100 * bound for bound in summary['standing_rate_interval'])
        rows.insert(4, (
            'standing', f'{100 * summary["standing_rate"]:.2f} %  [{low:.2f}, {high:.2f}]'))
    rows += flying_quality.rows(summary)
    if 'settling' in summary:
        ends = ', '.join(f'{name} {count}' for name, count in summary['settling'].items() if count)
        rows.append(('after touchdown', ends or 'none touched down'))
    rows += _fuel_rows(summary)
    ends = ', '.join(f'{name} {count}' for name, count in summary['outcomes'].items() if count)
    rows.append(('outcomes', ends))
    width = max(len(name) for name, _ in rows)
    return '\n'.join(f'{name:<{width}}  {value}' for name, value in rows)


def _fuel_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the rows that compare with the optimum, or else with a straight drop."""
    rows = []
    if summary.get('fuel_ratio_optimum') is not None:
        rows.append((
            'fuel / optimum', f'{summary["fuel_ratio_optimum"]:.4f}  (optimum '
            f'{summary["fuel_optimum_kg"]:.1f} kg, mean of {summary["optimum_sample"]} starts)'))
    elif summary['fuel_ratio'] is not None:
        why = summary.get('optimum_reason')
        rows.append(('fuel / straight drop', f'{summary["fuel_ratio"]:.4f}' + (
            f'  (no optimum: {why})' if why else '')))
    if summary.get('return_ceiling') is not None:
        rows.append((
            'ceiling of return', f'{summary["return_ceiling"]:.2f}  (optimum '
            f'{summary["time_optimum_s"]:.2f} s, mean of {summary["optimum_sample"]} starts)'))
    return rows


def _landed_return(summary: Mapping[str, Any]) -> str:
    """Return details of the mean return: the 5th percentile, and the mean of landed episodes."""
    landed = summary['mean_return_landed']
    parts = [f'5 %: below {summary["return_p05"]:.2f}']
    if landed is not None and summary['landed'] < summary['episodes']:
        parts.append(f'landed: {landed:.2f}')
    return f'  ({"; ".join(parts)})'


def write_json(path: Path, figures: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write metrics atomically: a reader finds the old file or the complete new one.

    :raises ValueError: for NaN or infinity, which JSON does not support; nothing is written.
    :raises OSError: naming the path; nothing changes.
    """
    text = json.dumps(figures, indent=2, allow_nan=False) + '\n'
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())
