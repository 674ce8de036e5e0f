# SPDX-License-Identifier: Apache-2.0
"""The processor or the GPU on which tensors are computed."""
from __future__ import annotations

import os

import torch

from ppo_agent_node.config.training_config import DEVICES


def find_device(name: str) -> torch.device:
    """Return the device that a setting names: `auto`, `cpu` or `cuda`.

    :raises ValueError: for another name, or when the device is not available.
    """
    if name not in DEVICES:
        raise ValueError(f'device: got {name!r}, expected one of {", ".join(DEVICES)}')
    there = torch.cuda.is_available()
    if name == 'cuda' and not there:
        raise ValueError(
            "device: got 'cuda', but torch finds no GPU here, expected 'auto' or 'cpu'")
    if not there or name == 'cpu':
        return torch.device('cpu')
    # torchrun numbers the ranks of a machine, which share its GPUs.
    rank = os.environ.get('LOCAL_RANK', '')
    if not rank.isdigit():
        return torch.device('cuda')
    return torch.device('cuda', int(rank) % max(torch.cuda.device_count(), 1))
