# SPDX-License-Identifier: Apache-2.0
"""Evaluation of several pilots under each condition and level, from the same starts.

A cell of the table is one evaluation, the same as :func:`runner.evaluate` with the condition's
settings and the level. All cells begin from one seed, so that pilots have the same starts and the
same draws.
"""
from __future__ import annotations

import functools
from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any
from typing import NamedTuple

from ppo_agent_node.evaluation import failures
from ppo_agent_node.evaluation import flying_quality
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.runner import evaluation_flight
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.scripted import for_vehicle
from rocket_sim_node.worlds import VectorEnv
from rocket_sim_node.worlds.jobs import Fleet
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.rocket import conditions

LEVELS = (7, 8)
EPISODES = 1000
"""Episodes of each cell."""
SEED = 20_000_000


class Cell(NamedTuple):
    """A cell of the table: one pilot under one condition on one level."""

    pilot: str
    condition: str
    level: int


Progress = Callable[[Cell, int, int], None]
"""Called with (cell, episodes counted in all cells so far, total)."""


def fly_table(
    env: VectorEnv, pilots: Mapping[str, Pilot], episodes: int = EPISODES, seed: int = SEED,
    levels: Sequence[int] = LEVELS, rows: Mapping[str, Mapping[str, float]] = conditions.SINGLE,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Fly the table in one world; for the arguments see :func:`fly_table_with`.

    >>> world = worlds.make('rocket', 256, observation='extended')
    >>> table = fly_table(world, {'expert': ExpertPilot(world.spec)})
    """
    return fly_table_with(SerialFleet(env), pilots, episodes, seed, levels, rows, progress)


def fly_table_with(
    fleet: Fleet, pilots: Mapping[str, Pilot], episodes: int = EPISODES, seed: int = SEED,
    levels: Sequence[int] = LEVELS, rows: Mapping[str, Mapping[str, float]] = conditions.SINGLE,
    progress: Progress | None = None, poll: Callable[[], None] = lambda: None,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Fly the table and return it, ready for JSON.

    - `world`, `num_envs`, `seed`, `episodes` of a cell, `world_settings`;
    - `pilots`, `levels`, `conditions`, the labels in order; `settings`, by label the condition
      settings that are not nominal;
    - `cells`, one for each pilot, level and condition: `pilot`, `level`, `condition` and the
      figures of :func:`metrics.success`, :func:`flying_quality.figures`, `fuel_ratio`, `outcomes`
      and `failed_starts`, each as in `evaluation.json`.

    :param pilots: by their labels in the table; see `for_vehicle`.
    :param episodes: of each cell, shared evenly over the rockets.
    :param rows: settings of the conditions by label.
    :param poll: called before each step.
    :param report: called with a text when a job is restarted.
    :raises ValueError: without pilots, levels or rows, for a world that has no conditions, and for
        settings that its reset refuses.
    """
    conditions.check_world(fleet.spec, 'all')
    cells = [Cell(pilot, label, level)
             for pilot in pilots for level in levels for label in rows]
    if not cells:
        raise ValueError(
            f'got {len(pilots)} pilots, {len(levels)} levels and {len(rows)} conditions, '
            'expected one or more of each')
    total = episodes * len(cells)

    def advance(number: int, done: int, _: int) -> None:
        if progress is not None:
            progress(cells[number], number * episodes + done, total)

    results = fleet.fly([
        functools.partial(
            evaluation_flight, fleet.spec,
            for_vehicle(pilots[cell.pilot], fleet.spec.after_reset(rows[cell.condition])),
            episodes, seed,
            functools.partial(advance, number), **{**rows[cell.condition], 'level': cell.level})
        for number, cell in enumerate(cells)], poll=poll, report=report)
    nominal = conditions.settings('nominal')
    return {
        'world': fleet.spec.name,
        'num_envs': fleet.spec.num_envs,
        'seed': seed,
        'episodes': episodes,
        'pilots': list(pilots),
        'levels': list(levels),
        'conditions': list(rows),
        'settings': {
            label: {name: value for name, value in row.items() if value != nominal.get(name)}
            for label, row in rows.items()},
        'cells': [_figures(cell, result) for cell, result in zip(cells, results, strict=True)],
        'world_settings': fleet.spec.settings,
    }


def _figures(cell: Cell, result: EvaluationResult) -> dict[str, Any]:
    """Return the stored results of a cell."""
    return {
        'pilot': cell.pilot, 'level': cell.level, 'condition': cell.condition,
        **metrics.success(result), 'fuel_ratio': metrics.fuel_ratio(result),
        **flying_quality.figures(result), 'outcomes': metrics.outcomes(result),
        'failed_starts': failures.failed_starts(result),
    }
