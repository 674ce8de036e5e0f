# SPDX-License-Identifier: Apache-2.0
"""An evaluation in numbers: one dictionary for the file, one table for the terminal."""
from __future__ import annotations

import json
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.evaluation.intervals import mean_interval
from ppo_agent_node.evaluation.intervals import wilson
from ppo_agent_node.evaluation.runner import EvaluationResult

UNITS = {
    'touchdown_speed': 'm/s', 'tilt': 'deg', 'distance': 'm', 'fuel_used_kg': 'kg',
    'fuel_bound_kg': 'kg', 'mean_length': 'steps', 'rest_distance': 'm',
    'fuel_optimum_kg': 'kg', 'time_optimum_s': 's',
}


def summarise(result: EvaluationResult, **extra: Any) -> dict[str, Any]:
    """Return the figures of an evaluation, ready for JSON: null where there is no value.

    - `landing_rate` with `landing_rate_interval`, Wilson, 95 %;
    - `mean_return` with `mean_return_interval`, 95 % (see `intervals.mean_interval`), and
      `return_std`;
    - `touchdown_speed` (m/s), `tilt` (deg from vertical), `distance` (m from the pad's centre),
      over the episodes that touched down, `fuel_used_kg` over all: each `mean` and `p95`, the
      95th percentile;
    - `fuel_bound_kg`, the mean least fuel of straight drops from the same starts, and
      `fuel_ratio`, the mean of used / least, both over landed episodes;
    - `standing_rate` with `standing_rate_interval`, Wilson, 95 %: how many stand after their
      touchdown, by the contact model that takes over from world `rocket`; in `rocket_planar` who
      landed stands; null elsewhere. `settling`, touchdowns by what happened then, and
      `rest_distance` (m) of those that stand: world `rocket` only;
    - `mean_length` in steps; `outcomes`, episodes by name, zeros included; `units`;
    - `world_settings`, those of the world as they were flown.

    :param extra: facts to be kept with them, such as the hash of the policy.
    :raises ValueError: for an extra that would overwrite a figure.
    """
    episodes, landed = result.episodes, result.landed
    count, successes = len(episodes), int(landed.sum())
    ground = result.ground
    names = result.spec.outcomes
    level = result.settings.get('level')
    summary: dict[str, Any] = {
        'world': result.spec.name,
        'level': None if level is None else int(level),
        'policy': result.pilot,
        'seed': result.seed,
        'num_envs': result.spec.num_envs,
        'reset_settings': result.reset_settings,
        'episodes': count,
        'landed': successes,
        'landing_rate': successes / count,
        'landing_rate_interval': list(wilson(successes, count)),
        'mean_return': float(episodes.episode_return.mean()),
        'mean_return_interval': list(mean_interval(episodes.episode_return)),
        'return_std': float(episodes.episode_return.std()),
        'touchdown_speed': _spread(episodes.touchdown_speed[ground]),
        'tilt': _spread(episodes.tilt[ground]),
        'distance': _spread(episodes.distance[ground]),
        'fuel_used_kg': _spread(episodes.fuel_used if result.is_rocket else np.zeros(0)),
        'fuel_bound_kg': _mean(result.fuel_bound[landed]),
        'fuel_ratio': _mean(episodes.fuel_used[landed] / result.fuel_bound[landed]),
        'mean_length': float(episodes.length.mean()),
        'outcomes': {
            name: int((episodes.outcome == code).sum()) for code, name in enumerate(names)},
        'units': UNITS,
        'world_settings': result.settings,
    }
    summary |= _standing(result)
    clash = sorted(set(extra) & set(summary))
    if clash:
        raise ValueError(f'{", ".join(clash)}: reserved for the figures')
    return {**summary, **extra}


def _standing(result: EvaluationResult) -> dict[str, Any]:
    """Return the figures of what happens after touchdown."""
    standing, settled = result.standing, result.settled
    if standing is None:
        return {'standing_rate': None, 'standing_rate_interval': None}
    count = int(standing.sum())
    more = {} if settled is None else {
        'settling': settled.verdicts, 'rest_distance': _spread(settled.rest_distance)}
    return {
        'standing_rate': count / len(standing),
        'standing_rate_interval': list(wilson(count, len(standing))), **more}


def _mean(values: NDArray[np.float64]) -> float | None:
    """Return the mean of the finite values, None where there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else None


def _spread(values: NDArray[np.float64]) -> dict[str, float | None]:
    finite = values[np.isfinite(values)]
    return {
        'mean': _mean(finite),
        'p95': float(np.quantile(finite, 0.95)) if finite.size else None,
    }


def table(summary: Mapping[str, Any]) -> str:
    """Return the figures as aligned text for a terminal."""
    low, high = (100 * bound for bound in summary['landing_rate_interval'])
    least, most = summary['mean_return_interval']
    level = '' if summary['level'] is None else f', level {summary["level"]}'
    rows = [
        ('world', f'{summary["world"]}{level}'),
        ('policy', str(summary['policy'])),
        ('episodes', f'{summary["episodes"]} (seed {summary["seed"]})'),
        ('landed', f'{100 * summary["landing_rate"]:.2f} %  [{low:.2f}, {high:.2f}]'),
        ('return', f'{summary["mean_return"]:.2f}  [{least:.2f}, {most:.2f}]'),
        ('length', f'{summary["mean_length"]:.1f} steps'),
    ]
    for name, unit in (('touchdown_speed', 'm/s'), ('tilt', 'deg'), ('distance', 'm'),
                       ('fuel_used_kg', 'kg')):
        if summary[name]['mean'] is not None:
            label = name.removesuffix('_kg').replace('_', ' ')
            if summary['standing_rate'] is None:
                # No rocket: nothing is taken down at the moment of touchdown.
                label = label.replace('touchdown speed', 'speed at the end')
            rows.append((
                label,
                f'{summary[name]["mean"]:.4g} {unit}  (95 %: below {summary[name]["p95"]:.4g})'))
    if summary['standing_rate'] is not None:
        low, high = (100 * bound for bound in summary['standing_rate_interval'])
        rows.insert(4, (
            'standing', f'{100 * summary["standing_rate"]:.2f} %  [{low:.2f}, {high:.2f}]'))
    if 'settling' in summary:
        ends = ', '.join(f'{name} {count}' for name, count in summary['settling'].items() if count)
        rows.append(('after touchdown', ends or 'none came down'))
    rows += _fuel_rows(summary)
    ends = ', '.join(f'{name} {count}' for name, count in summary['outcomes'].items() if count)
    rows.append(('outcomes', ends))
    width = max(len(name) for name, _ in rows)
    return '\n'.join(f'{name:<{width}}  {value}' for name, value in rows)


def _fuel_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the rows that compare with the optimum, or with a straight drop without one."""
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


def write_json(path: Path, figures: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write figures; a reader finds the old file or the whole new one, never half of it.

    :raises ValueError: for NaN or infinity, which JSON does not know; nothing is written.
    :raises OSError: naming the path; nothing changes.
    """
    text = json.dumps(figures, indent=2, allow_nan=False) + '\n'
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())
