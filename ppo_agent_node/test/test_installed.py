# SPDX-License-Identifier: Apache-2.0
"""Whether the package is installed whole; the repository tests what it does."""
from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.pilots.choice import choose
from rocket_sim_node.worlds import make


@pytest.mark.parametrize('name', [
    'train.launch.yaml', 'land.launch.yaml', 'evaluate.launch.yaml', 'fly.launch.yaml',
    'parameters/agent.yaml', 'parameters/simulator.yaml'])
def test_a_launch_file_is_shared(name: str) -> None:
    assert (Path(get_package_share_directory('ppo_agent_node')) / 'launch' / name).is_file()


@pytest.mark.parametrize('name', [
    'ppo_agent', 'expert_pilot', 'evaluate', 'watch', 'action_server'])
def test_a_node_can_be_imported(name: str) -> None:
    assert callable(import_module(f'ppo_agent_node.nodes.{name}').main)


@pytest.mark.parametrize(('world', 'policy'), [
    ('rocket', 'rocket'), ('rocket', 'robust'), ('rocket', 'hoverslam'),
    ('rocket', 'from_scratch'),
    ('rocket_planar', 'rocket_planar'), ('lunar_lander', 'lunar_lander')])
def test_a_policy_that_ships_is_found_by_its_name(world: str, policy: str) -> None:
    seen = {} if world == 'lunar_lander' else {'observation': 'extended'}
    env = make(world, num_envs=2, seed=1, **seen)
    action = choose(policy, env.spec).pilot(env.reset(seed=1))
    assert len(action) == 2
    assert np.isfinite(action).all()


@pytest.mark.parametrize('world', ['rocket', 'rocket_planar', 'lunar_lander'])
def test_a_world_has_a_preset(world: str) -> None:
    assert load_preset('default', world, seed=3).run.seed == 3
