# SPDX-License-Identifier: Apache-2.0
"""Proximal policy optimisation: one update from one roll-out.

Schulman et al., 'Proximal policy optimization algorithms', 2017, equation 7 (the clipped
objective), with the usual details of Huang et al., 'The 37 implementation details of proximal
policy optimization', 2022.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_
from torch.optim import Adam

from ppo_agent_node.learning.config import PPOConfig
from ppo_agent_node.learning.networks import Critic
from ppo_agent_node.learning.policies import Policy
from ppo_agent_node.learning.rollout import Batch

NAN = float('nan')


@dataclass(frozen=True)
class Diagnostics:
    """How an update went, by the names that CleanRL made usual; NaN where it did not happen."""

    policy_loss: float
    """mean of minus the clipped objective, over all minibatches"""
    value_loss: float
    """half the mean squared error of the critic, in units of (reward x reward_scale)^2"""
    entropy: float
    """of the policy, mean over the samples, nats"""
    approx_kl: float
    """nats the policy moved by: mean of r - 1 - log r over the last minibatch (Schulman,
    'Approximating KL divergence', 2020, estimator k3)"""
    clipfrac: float
    """part of the samples whose ratio left the clip range, mean over the minibatches"""
    explained_variance: float
    """1 - Var(target - value) / Var(target), before the update: 1 is a perfect critic, 0 one no
    better than a constant"""
    grad_norm: float
    """of the policy before clipping, mean over the minibatches"""
    updates: float
    """minibatches that the policy learnt from"""


def clipped_objective(ratio: Tensor, advantage: Tensor, clip_range: float) -> Tensor:
    """Return min(r A, clip(r, 1 - eps, 1 + eps) A) for each sample (equation 7), `(S,)`."""
    return torch.minimum(
        ratio * advantage, ratio.clamp(1 - clip_range, 1 + clip_range) * advantage)


def squared_error(value: Tensor, old: Tensor, target: Tensor, clip_range: float) -> Tensor:
    """Return (V - target)^2 or, clipped, the larger of it and (clip(V, old ± eps) - target)^2.

    The latter as OpenAI's baselines do it in PPO2 (implementation detail 9 of Huang et al.): a
    value on its way to the target stops learning once it is eps from where the update began.

    :param value: `(S,)` of the critic as it is.
    :param old: `(S,)` of the critic as it was at the roll-out.
    :param clip_range: eps, in the critic's units; 0: not clipped.
    """
    error = (value - target).square()
    if not clip_range:
        return error
    near = old + (value - old).clamp(-clip_range, clip_range)
    return torch.maximum(error, (near - target).square())


def explained_variance(value: Tensor, target: Tensor) -> float:
    """Return 1 - Var(target - value) / Var(target); NaN when the targets are all equal."""
    variance = target.var()
    return float(1 - (target - value).var() / variance) if variance > 0 else NAN


def update(
    policy: Policy,
    critic: Critic,
    policy_optimiser: Adam,
    critic_optimiser: Adam,
    batch: Batch,
    config: PPOConfig,
    generator: torch.Generator,
    train_policy: bool = True,
    poll: Callable[[], None] = lambda: None,
) -> Diagnostics:
    """Improve policy and critic in place.

    :param generator: shuffles the samples.
    :param train_policy: False trains the critic only.
    :param poll: called before each minibatch; may raise to end the update half-way.
    """
    policy_losses, value_losses, entropies, clipped, norms = [], [], [], [], []
    kl = torch.tensor(NAN)
    learning = train_policy
    for _ in range(config.n_epochs):
        for index in torch.randperm(len(batch.value), generator=generator).split(
                config.batch_size):
            poll()
            part = batch.take(index)

            value_loss = 0.5 * squared_error(
                critic(part.observation), part.value, part.target, config.value_clip_range).mean()
            critic_optimiser.zero_grad()
            value_loss.backward()
            clip_grad_norm_(critic.parameters(), config.max_grad_norm)
            critic_optimiser.step()
            value_losses.append(value_loss.detach())
            if not learning:
                continue

            advantage = part.advantage
            if config.normalise_advantages and len(index) > 1:
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            log_prob, entropy = policy.log_prob_entropy(part.observation, part.action)
            log_ratio = log_prob - part.log_prob
            ratio = log_ratio.exp()
            with torch.no_grad():
                kl = (ratio - 1 - log_ratio).mean()
                clipped.append(((ratio - 1).abs() > config.clip_range).float().mean())
            if 0 < config.target_kl < kl:
                learning = False
                continue
            policy_loss = -clipped_objective(ratio, advantage, config.clip_range).mean()
            loss = policy_loss - config.entropy_coefficient * entropy.mean()
            policy_optimiser.zero_grad()
            loss.backward()
            norms.append(clip_grad_norm_(policy.parameters(), config.max_grad_norm))
            policy_optimiser.step()
            policy.constrain()
            policy_losses.append(policy_loss.detach())
            entropies.append(entropy.detach().mean())
    return Diagnostics(
        policy_loss=_mean(policy_losses), value_loss=_mean(value_losses),
        entropy=_mean(entropies), approx_kl=float(kl), clipfrac=_mean(clipped),
        explained_variance=explained_variance(batch.value, batch.target),
        grad_norm=_mean(norms), updates=len(policy_losses),
    )


def _mean(values: list[Tensor]) -> float:
    return float(torch.stack(values).mean()) if values else NAN
