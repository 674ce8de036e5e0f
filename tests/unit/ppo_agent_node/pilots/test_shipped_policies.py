# SPDX-License-Identifier: Apache-2.0
"""The shipped policies reach the figures of docs/results/learning.md on unseen starts."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node import worlds

pytestmark = pytest.mark.slow
SEED = 50_000_000
"""of the starts; trainings derive theirs, evaluations begin at 20, 30 and 40 million"""


@pytest.mark.parametrize(('level', 'least_return'), [(7, 294.9), (8, 294.5)])
def test_the_planar_policy_that_ships_flies_as_it_was_measured(
        tmp_path: Path, level: int, least_return: float) -> None:
    world = worlds.make('rocket_planar', 256)
    pilot = PolicyPilot(find_policy('rocket_planar', 'rocket_planar', tmp_path), world.spec)
    result = evaluate(world, pilot, 256, SEED, level=level)
    assert int(result.landed.sum()) == 256
    assert result.episodes.episode_return.mean() >= least_return


@pytest.mark.parametrize(('name', 'task', 'landed', 'least_return'), [
    ('default', {'level': 1}, 256, 295.0),
    ('default', {'level': 7}, 256, 295.2),
    ('default', {'level': 8}, 252, 289.0),
    ('robust', {'level': 7}, 256, 291.0),
    ('robust', {'level': 7, 'conditions': 'mix'}, 255, 286.5),
    ('robust', {'level': 8, 'conditions': 'mix'}, 254, 283.0),
    ('from_scratch', {'level': 7}, 254, 290.0),
    ('hoverslam', {'level': 7, 'conditions': 'hoverslam'}, 255, 293.4),
])
def test_a_rocket_policy_that_ships_flies_as_it_was_measured(
        tmp_path: Path, name: str, task: dict[str, Any], landed: int,
        least_return: float) -> None:
    world = worlds.make('rocket', 256, observation='extended')
    pilot = PolicyPilot(find_policy(name, 'rocket', tmp_path), world.spec)
    result = evaluate(world, pilot, 256, SEED, **task)
    assert int(result.landed.sum()) >= landed
    assert result.episodes.episode_return.mean() >= least_return


def test_the_lander_that_ships_flies_as_it_was_measured(tmp_path: Path) -> None:
    world = worlds.make('lunar_lander', 256)
    pilot = PolicyPilot(find_policy('lunar_lander', 'lunar_lander', tmp_path), world.spec)
    returns = evaluate(world, pilot, 256, SEED).episodes.episode_return
    assert int((returns >= 200).sum()) >= 252
    assert returns.mean() >= 287.0
