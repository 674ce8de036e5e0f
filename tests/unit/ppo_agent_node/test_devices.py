# SPDX-License-Identifier: Apache-2.0
"""The device on which tensors are computed, chosen by name."""
from __future__ import annotations

import pytest
import torch

from ppo_agent_node.devices import find_device


def test_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    assert find_device('auto') == find_device('cpu') == torch.device('cpu')
    with pytest.raises(ValueError, match="device: got 'cuda', but torch finds no GPU"):
        find_device('cuda')


def test_with_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: True)
    assert find_device('auto') == find_device('cuda') == torch.device('cuda')
    assert find_device('cpu') == torch.device('cpu')


def test_an_unknown_device_is_named() -> None:
    with pytest.raises(ValueError, match="device: got 'tpu', expected one of auto, cpu, cuda"):
        find_device('tpu')
