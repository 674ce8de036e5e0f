# SPDX-License-Identifier: Apache-2.0
"""Losses of policy and critic per sample, with their gradients in closed form."""
from __future__ import annotations

import torch
from torch import Tensor


def clipped_objective(ratio: Tensor, advantage: Tensor, clip_range: float) -> Tensor:
    """Return min(r A, clip(r, 1 - eps, 1 + eps) A) for each sample (equation 7), `(S,)`."""
    return torch.minimum(
        ratio * advantage, ratio.clamp(1 - clip_range, 1 + clip_range) * advantage)


def objective_gradient(ratio: Tensor, advantage: Tensor, clip_range: float) -> Tensor:
    """Return the objective's gradient with respect to log r, `(S,)`: r A, or 0 where clipped."""
    plain = ratio * advantage
    clipped = ratio.clamp(1 - clip_range, 1 + clip_range).mul_(advantage)
    return plain.masked_fill_(plain > clipped, 0.0)


def squared_error(value: Tensor, old: Tensor, target: Tensor, clip_range: float) -> Tensor:
    """Return (V - target)^2 or, clipped, the larger of it and (clip(V, old ± eps) - target)^2.

    The latter is that of OpenAI's baselines in PPO2 (implementation detail 9 of Huang et al.): a
    value moving towards its target has no gradient once it is eps from its initial value.

    :param value: `(S,)`, of the current critic.
    :param old: `(S,)`, of the critic at the time of the roll-out.
    :param clip_range: eps, in the critic's units; 0: not clipped.
    """
    error = (value - target).square()
    if not clip_range:
        return error
    near = old + (value - old).clamp(-clip_range, clip_range)
    return torch.maximum(error, (near - target).square())


def error_gradient(value: Tensor, old: Tensor, target: Tensor, clip_range: float) -> Tensor:
    """Return half the gradient of `squared_error` with respect to V: V - target, or 0."""
    error = value - target
    if clip_range:
        moved = value - old
        near = moved.clamp(-clip_range, clip_range)
        clipped = error.abs() < (old + near - target).abs()
        error.masked_fill_(clipped & (moved != near), 0.0)
    return error
