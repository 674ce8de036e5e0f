# SPDX-License-Identifier: Apache-2.0
"""Flies policies on the fresh starts of an experiment, and caches the figures."""
from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from typing import NamedTuple

from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.averages import spread
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.policy import PolicyPilot
from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket import conditions

_ROCKETS = 500
_KEPT = 'flown.json'


class Task(NamedTuple):
    """A row of the table of conditions and a level."""

    condition: str = 'nominal'
    level: int = 7

    def __str__(self) -> str:
        """Return its name in the figures."""
        return f'{self.condition}, level {self.level}'


class Sample(NamedTuple):
    """Number of episodes of each task, and their seed."""

    episodes: int
    seed: int


def fly(policy: Path, task: Task, sample: Sample) -> dict[str, Any]:
    """Return the figures of a policy; those of an earlier flight if there are any.

    All policies fly a sample from the same starts with the same random draws, so differences
    between policies are less noisy than the figures of one. `metrics.success` documents most
    figures; the touchdown speed, m/s, is that of landings.
    """
    kept = policy.parent / _KEPT
    flown = json.loads(kept.read_text('utf-8')) if kept.exists() else {}
    key = f'{policy.stem}, {task}, {sample.episodes} episodes of seed {sample.seed}'
    if key not in flown:
        world = worlds.make('rocket', min(_ROCKETS, sample.episodes), observation='extended')
        result = evaluate(
            world, PolicyPilot(policy, world.spec), sample.episodes, sample.seed,
            **conditions.SINGLE[task.condition], level=task.level)
        flown[key] = {
            **metrics.success(result), 'fuel_ratio': metrics.fuel_ratio(result),
            'touchdown_speed': spread(result.episodes.touchdown_speed[result.landed]),
            'outcomes': metrics.outcomes(result)}
        metrics.write_json(kept, flown)
    found: dict[str, Any] = flown[key]
    return found
