# SPDX-License-Identifier: Apache-2.0
"""Generalised advantage estimation (GAE) for a batch whose episodes end at any step."""
from __future__ import annotations

import torch
from torch import Tensor


@torch.no_grad()
def advantages_and_returns(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    terminated: Tensor,
    truncated: Tensor,
    gamma: float,
    gae_lambda: float,
) -> tuple[Tensor, Tensor]:
    """Return advantages and the critic's targets, `(T, N)` each.

    Schulman et al., 'High-dimensional continuous control using generalized advantage
    estimation', 2016, equations 11 to 16: with delta_t = r_t + gamma V(s_t+1) - V(s_t),
    A_t = delta_t + gamma lambda A_t+1. Where an episode ends, so does the sum over later deltas.
    After a termination there is no further reward, V(s_t+1) = 0. A truncation only stops the
    observation (Pardo et al., 'Time limits in reinforcement learning', 2018), so V(s_t+1) is the
    value of the episode's own final observation.

    :param reward: `(T, N)`, reward of the step from t to t + 1.
    :param value: `(T, N)`, V of the observation at t.
    :param next_value: `(T, N)`, V of the observation at t + 1 *of the same episode*: its final
        observation where the episode was truncated. Not used where it terminated.
    :param terminated: `(T, N)` bool.
    :param truncated: `(T, N)` bool.
    """
    going_on = (~(terminated | truncated)).to(value.dtype)
    delta = reward + gamma * torch.where(terminated, 0.0, next_value) - value
    advantage = torch.empty_like(value)
    later = torch.zeros_like(value[0])
    for step in range(len(value) - 1, -1, -1):
        later = delta[step] + gamma * gae_lambda * going_on[step] * later
        advantage[step] = later
    return advantage, advantage + value
