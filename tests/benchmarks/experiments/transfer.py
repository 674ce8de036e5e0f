# SPDX-License-Identifier: Apache-2.0
"""Flies policies in worlds and conditions in which they were not trained.

Each policy and the expert fly every condition of the evaluation's table in both rocket worlds. The
lander's transfer to Gymnasium's LunarLander is `bench transfer`.
"""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.experiments.options import Options
from ppo_agent_node.evaluation.conditions_table import fly_table
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.pilots.search import shipped_names
from rocket_sim_node import worlds
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.rocket import conditions

WORLDS = ('rocket', 'rocket_planar')
LEVEL = 7
_ROCKETS = 250
_QUICK = ('nominal', 'mix')


def measure(options: Options) -> dict[str, Any]:
    """Fly all shipped policies for rockets; return the cells of the matrix.

    Nothing is trained, so the training seeds do not matter.
    """
    cells = []
    rows = {label: row for label, row in conditions.SINGLE.items()
            if not options.quick or label in _QUICK}
    for world in WORLDS:
        env = worlds.make(
            world, min(_ROCKETS, options.sample.episodes), observation='extended')
        flown = fly_table(
            env, pilots(env.spec), options.sample.episodes, options.sample.seed, (LEVEL,), rows)
        cells += [{'world': world, **{name: cell[name] for name in (
            'pilot', 'condition', 'level', 'episodes', 'landed', 'landing_rate',
            'landing_rate_interval', 'mean_return', 'mean_return_interval', 'tanks_dry')}}
            for cell in flown['cells']]
        print(f'  {world}: {len(flown["cells"])} cells', flush=True)
    return {'runs': [], 'cells': cells}


def pilots(spec: WorldSpec) -> dict[str, Pilot]:
    """Return the expert and the shipped policies that can fly in a world, by name."""
    found: dict[str, Pilot] = {'expert': ExpertPilot(spec)}
    for name in shipped_names():
        try:
            found[name] = PolicyPilot(Path(find_policy(name, spec.name)), spec)
        except ValueError:
            continue  # the lander's policy has other observations and actions
    return found


def columns(figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return worlds and pilots in order."""
    return list(dict.fromkeys((cell['world'], cell['pilot']) for cell in figures['cells']))


def rows(figures: Mapping[str, Any]) -> list[str]:
    """Return the conditions in order."""
    return list(dict.fromkeys(cell['condition'] for cell in figures['cells']))


def cell(figures: Mapping[str, Any], column: tuple[str, str], condition: str) -> dict[str, Any]:
    """Return a cell of the matrix."""
    found: dict[str, Any]
    found, = (one for one in figures['cells'] if (
        one['world'], one['pilot'], one['condition']) == (*column, condition))
    return found


def table(figures: Mapping[str, Any]) -> list[Sequence[str]]:
    """Return a header row, and rows of landing rate and mean return: nominal and the sets."""
    head = ('flown in, by', *(label for label in rows(figures) if label in (
        'nominal', 'mix', 'harsh')))
    found: list[Sequence[str]] = [head]
    for column in columns(figures):
        flown = [cell(figures, column, label) for label in head[1:]]
        found.append((f'{column[0]}, {column[1]}', *(
            f'{100 * one["landing_rate"]:.1f} %, {one["mean_return"]:.1f} '
            f'[{one["mean_return_interval"][0]:.1f}, {one["mean_return_interval"][1]:.1f}]'
            for one in flown)))
    return found
