# SPDX-License-Identifier: Apache-2.0
"""Whether the package is installed whole; the repository tests what it does."""
from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory

from rocket_sim_node import worlds


@pytest.mark.parametrize('name', worlds.names())
def test_a_world_flies(name: str) -> None:
    world = worlds.make(name, num_envs=2, seed=1)
    first = world.reset(seed=1)
    spec = world.spec
    idle = (np.tile(np.float32(spec.action_idle), (2, 1)) if spec.continuous
            else np.full(2, spec.action_idle[0], np.int32))
    observation, reward, *_ = world.step(idle)
    assert observation.shape == first.shape
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()


@pytest.mark.parametrize('file', [
    'launch/simulate.launch.yaml', 'launch/parameters/simulator.yaml', 'views/hoverslam.rviz',
    'views/foxglove.json'])
def test_a_file_is_shared(file: str) -> None:
    assert (Path(get_package_share_directory('rocket_sim_node')) / file).is_file()


@pytest.mark.parametrize('name', ['simulator', 'rerun_recorder', 'bag_recorder', 'ros_bridge'])
def test_a_node_can_be_imported(name: str) -> None:
    assert callable(import_module(f'rocket_sim_node.nodes.{name}').main)
