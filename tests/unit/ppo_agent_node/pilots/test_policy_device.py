# SPDX-License-Identifier: Apache-2.0
"""Policies fly on the device that is asked for, or name what is missing."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node import worlds


def actions(world: str, device: str) -> NDArray[np.float32]:
    """Return the actions of the policy that ships, for the first observations."""
    made = worlds.make(world, num_envs=300)
    return np.asarray(PolicyPilot(find_policy(world, world), made.spec, device)(made.reset(1)))


@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_without_a_gpu_auto_is_the_cpu(world: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    assert np.array_equal(actions(world, 'auto'), actions(world, 'cpu'))
    with pytest.raises(ValueError, match="device: got 'cuda', but torch finds no GPU here"):
        actions(world, 'cuda')


@pytest.mark.skipif(not torch.cuda.is_available(), reason='no GPU')
@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_the_gpu_flies_the_same_but_for_rounding(world: str) -> None:
    np.testing.assert_allclose(actions(world, 'cuda'), actions(world, 'cpu'), atol=1e-4)


@pytest.mark.parametrize('device', ['cuda', 'cuda:0', 'gpu', ''])
def test_an_onnx_file_needs_no_gpu(device: str, tmp_path: Path) -> None:
    spec = worlds.make('rocket').spec
    message = f"device: got '{device}', expected 'cpu' or 'auto' for .*x\\.onnx"
    with pytest.raises(ValueError, match=message):
        PolicyPilot(tmp_path / 'x.onnx', spec, device)
