# SPDX-License-Identifier: Apache-2.0
"""The examples of the documents run, in little."""
from __future__ import annotations

import runpy
from pathlib import Path

import pytest
import torch

from rocket_sim_node.gym import IDS

EXAMPLES = Path(__file__).parents[2] / 'docs' / 'examples'


@pytest.fixture(autouse=True)
def _threads() -> object:
    """Examples set the number of threads; put it back."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket'])
def test_ppo_in_a_single_file_learns_something(world: str) -> None:
    example = runpy.run_path(str(EXAMPLES / 'single_file_ppo.py'))
    options = {'name': IDS[world], 'num_envs': 8, 'num_steps': 32, 'minibatches': 4}
    first = example['train'](example['Options'](**options, steps=256)).state_dict()
    again = example['train'](example['Options'](**options, steps=256)).state_dict()
    more = example['train'](example['Options'](**options, steps=512)).state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not all(torch.equal(first[name], more[name]) for name in first)


def test_ppo_of_stable_baselines3_runs() -> None:
    pytest.importorskip('stable_baselines3')
    example = runpy.run_path(str(EXAMPLES / 'sb3_ppo.py'))
    model = example['train'](num_envs=4, steps=256, n_steps=64, verbose=0)
    assert model.num_timesteps == 256
