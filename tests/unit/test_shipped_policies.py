# SPDX-License-Identifier: Apache-2.0
"""The policies that ship do what the README says of them, in each world that they fit."""
from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.policy import PolicyPilot
from rocket_sim_node import worlds

POLICIES = Path(str(resources.files('ppo_agent_node'))) / 'policies'


@pytest.mark.parametrize('flown_in', ['rocket', 'rocket_planar'])
@pytest.mark.parametrize('trained_in', ['rocket', 'rocket_planar'])
def test_policies_of_rockets_land_and_stand_in_both_worlds(trained_in: str, flown_in: str) -> None:
    world = worlds.make(flown_in, num_envs=100)
    pilot = PolicyPilot(POLICIES / f'{trained_in}.safetensors', world.spec)
    assert not pilot.unfamiliar
    summary = summarise(evaluate(world, pilot, 200, 77, level=7))
    assert summary['landed'] == 200
    assert summary['standing_rate'] == 1.0
    assert summary['mean_return'] > 292


def test_the_lander_solves_its_task() -> None:
    """200 is the mark; 250 over 500 episodes was asked for, and these are 100."""
    world = worlds.make('lunar_lander', num_envs=50)
    pilot = PolicyPilot(POLICIES / 'lunar_lander.safetensors', world.spec)
    summary = summarise(evaluate(world, pilot, 100, 77))
    assert summary['mean_return'] > 270
    assert summary['landing_rate'] > 0.95


def test_a_policy_of_another_kind_of_world_is_refused() -> None:
    with pytest.raises(ValueError, match='observation_names'):
        PolicyPilot(POLICIES / 'lunar_lander.safetensors', worlds.make('rocket').spec)
    with pytest.raises(ValueError, match='action_names'):
        PolicyPilot(
            POLICIES / 'lunar_lander.safetensors',
            worlds.make('lunar_lander', continuous=True).spec)
