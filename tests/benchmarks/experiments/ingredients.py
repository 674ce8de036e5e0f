# SPDX-License-Identifier: Apache-2.0
"""Measures the contribution of each ingredient of preset `default`, changed one at a time.

The variants are those of `variants`. All differences are paired by training seed, on the same
starts. Variants of PPO have the clone of the base, bit for bit, which is flown once. The result of
PPO is the policy of its last iteration, because the best policy would hide a deterioration.
"""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any

from benchmarks.experiments import statistics
from benchmarks.experiments import variants
from benchmarks.experiments.flights import Task
from benchmarks.experiments.flights import fly
from benchmarks.experiments.options import Options
from benchmarks.experiments.statistics import Estimate
from benchmarks.experiments.training import train
from ppo_agent_node.evaluation.conditions_files import percent

TASKS = (Task('nominal', 7), Task('nominal', 8))
STAGES = ('cloned', 'last')


def measure(options: Options) -> dict[str, Any]:
    """Train and fly the base and all variants; return the figures of each run."""
    runs, flown = [], []
    for seed in options.seeds:
        for variant in (variants.BASE, *variants.VARIANTS):
            run = train(variants.recipe(variant, options.quick), seed, options.runs)
            runs.append(run.note())
            for stage in STAGES if variant.stage == variants.IMITATION else STAGES[1:]:
                for task in TASKS:
                    flown.append({
                        'variant': variant.name, 'seed': seed, 'stage': stage, 'task': str(task),
                        **fly(run.policy(stage), task, options.sample)})
    return {
        'rockets': variants.ROCKETS,
        'scale': dict(variants.QUICK if options.quick else variants.SCALE),
        'variants': [variant._asdict() for variant in variants.VARIANTS],
        'runs': runs, 'flown': flown}


def chosen(
    figures: Mapping[str, Any], variant: str, stage: str, task: Task,
) -> list[dict[str, Any]]:
    """Return the figures of a variant, one entry per seed; its clone may be that of the base."""
    found = [one for one in figures['flown'] if one['stage'] == stage
             and one['task'] == str(task) and one['variant'] == variant]
    return found or chosen(figures, variants.BASE.name, stage, task)


def differences(
    figures: Mapping[str, Any], variant: str, stage: str, task: Task,
) -> list[float]:
    """Return the difference in mean return between a variant and the base, for each seed."""
    base = chosen(figures, variants.BASE.name, stage, task)
    return [one['mean_return'] - other['mean_return'] for one, other in zip(
        chosen(figures, variant, stage, task), base, strict=True)]


def table(figures: Mapping[str, Any]) -> list[Sequence[str]]:
    """Return a header row and a row per variant: absolute figures and differences of return."""
    rows: list[Sequence[str]] = [(
        'variant', 'level', 'clone: return', 'after PPO: return', 'landed, %', 'fuel ratio',
        'touchdown, 95 % below, m/s')]
    for variant in (variants.BASE.name, *(one['name'] for one in figures['variants'])):
        for task in TASKS:
            policy = chosen(figures, variant, 'last', task)
            rate = statistics.landed(policy)
            rows.append((
                variant, str(task.level),
                *(_return(figures, variant, stage, task) for stage in STAGES),
                f'{percent(rate.value / 100)} [{rate.low:.2f}, {rate.high:.2f}]',
                mean_text([one['fuel_ratio'] for one in policy], 3),
                mean_text([one['touchdown_speed']['p95'] for one in policy], 3)))
    return rows


def _return(figures: Mapping[str, Any], variant: str, stage: str, task: Task) -> str:
    if variant == variants.BASE.name:
        return mean_text(
            [one['mean_return'] for one in chosen(figures, variant, stage, task)], 2)
    found = differences(figures, variant, stage, task)
    if not any(found):
        return 'as the base'
    return statistics.over_seeds(found).text(2)


def mean_text(values: Sequence[float | None], digits: int) -> str:
    """Return the mean over the seeds as text, '' if a seed has no value."""
    known = [value for value in values if value is not None]
    return f'{sum(known) / len(known):.{digits}f}' if len(known) == len(values) else ''


def worth(figures: Mapping[str, Any], stage: str, task: Task) -> dict[str, Estimate]:
    """Return the difference of return between each variant and the base, by name."""
    return {one['name']: statistics.over_seeds(differences(figures, one['name'], stage, task))
            for one in figures['variants']}
