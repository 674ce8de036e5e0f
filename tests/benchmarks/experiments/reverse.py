# SPDX-License-Identifier: Apache-2.0
"""Shows the reach H of the reverse curriculum over time, with preset `from_scratch`.

The curves come from the `train.jsonl` of each run, the figures from its policy on fresh starts.
"""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any

from benchmarks.experiments.flights import Task
from benchmarks.experiments.flights import fly
from benchmarks.experiments.options import Options
from benchmarks.experiments.training import Recipe
from benchmarks.experiments.training import train
from ppo_agent_node.evaluation.conditions_files import percent

FULL_REACH = 194.8
"""m, from the spawn height down to touchdown"""
TASK = Task('nominal', 7)
_RECIPE = Recipe('from-scratch', 'from_scratch')
_QUICK = Recipe('from-scratch', 'from_scratch', {
    'iterations': 3, 'curriculum_reach_landing_rate': 0.0, 'curriculum_window': 1,
    'selection_episodes': 8, 'selection_interval': 1, 'selection_from_landing_rate': 0.0}, 8)
_CURVES = ('iteration', 'steps', 'reach', 'landing_rate', 'selection_return')


def measure(options: Options) -> dict[str, Any]:
    """Train with each seed; return the curves of the runs and the figures of the policies."""
    found, runs = [], []
    for seed in options.seeds:
        run = train(_QUICK if options.quick else _RECIPE, seed, options.runs)
        runs.append(run.note())
        lines = [line for line in run.folder.lines() if line['stage'] == 'finetune']
        found.append({
            'seed': seed, **passed(lines),
            'curves': {name: [line.get(name) for line in lines] for name in _CURVES},
            'flown': fly(run.folder.policy, TASK, options.sample)})
    return {'runs': runs, 'seeds': found}


def passed(lines: Sequence[Mapping[str, Any]]) -> dict[str, int | None]:
    """Return the iteration and the step from which roll-outs began at all heights.

    :param lines: lines of fine-tuning in `train.jsonl`.
    """
    full = [line for line in lines if line['reach'] >= FULL_REACH - 1e-6]
    return {name: full[0][name] if full else None for name in ('iteration', 'steps')}


def table(figures: Mapping[str, Any]) -> list[Sequence[str]]:
    """Return a header row and a row for each seed."""
    rows: list[Sequence[str]] = [(
        'seed', 'full reach: iteration', 'million steps', 'landed, %', 'return', 'fuel ratio')]
    for one in figures['seeds']:
        flown, steps = one['flown'], one['steps']
        low, high = flown['mean_return_interval']
        rows.append((
            str(one['seed']), str(one['iteration'] or 'never'),
            f'{steps / 1e6:.1f}' if steps else '', percent(flown['landing_rate']),
            f'{flown["mean_return"]:.2f} [{low:.2f}, {high:.2f}]',
            f'{flown["fuel_ratio"]:.3f}' if flown['fuel_ratio'] else ''))
    return rows
