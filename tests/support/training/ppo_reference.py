# SPDX-License-Identifier: Apache-2.0
"""A textbook PPO update with autograd and torch's Adam, one minibatch after the other."""
from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_
from torch.optim import Adam

from ppo_agent_node.config.training_config import PPOConfig
from ppo_agent_node.ppo.losses import clipped_objective
from ppo_agent_node.ppo.losses import squared_error
from ppo_agent_node.ppo.networks.mlp import Critic
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.rollout_buffer import Batch
from ppo_agent_node.ppo.update import Diagnostics
from ppo_agent_node.ppo.update import explained_variance


def optimisers(
    policy: Policy, critic: Critic, rates: Sequence[float], fused: bool = False,
) -> tuple[Adam, Adam]:
    """Return optimisers of policy and critic; `rates` are those of policy, noise and critic."""
    noise = policy.noise_parameters()
    others = [p for p in policy.parameters() if all(p is not q for q in noise)]
    groups = [{'params': others, 'lr': rates[0]}, {'params': noise, 'lr': rates[1]}]
    return (Adam(groups if noise else groups[:1], eps=1e-5, fused=fused),
            Adam(critic.parameters(), lr=rates[2], eps=1e-5, fused=fused))


def update(
    policy: Policy, critic: Critic, adams: tuple[Adam, Adam], batch: Batch, config: PPOConfig,
    generator: torch.Generator, train_policy: bool = True,
) -> Diagnostics:
    """Improve policy and critic in place."""
    figures: dict[str, list[Tensor]] = {
        name: [] for name in ('policy', 'value', 'entropy', 'clipped', 'norm')}
    kl, learning = torch.tensor(math.nan), train_policy
    if config.trained_layers:
        for layer in policy.network.linear[:-config.trained_layers]:
            layer.requires_grad_(False)
    for _ in range(config.n_epochs):
        for index in torch.randperm(len(batch.value), generator=generator).split(
                config.batch_size):
            part = Batch(*(tensor[index] for tensor in batch))
            error = 0.5 * squared_error(
                critic(part.observation), part.value, part.target, config.value_clip_range)
            adams[1].zero_grad()
            error.mean().backward()
            clip_grad_norm_(critic.parameters(), config.max_grad_norm)
            adams[1].step()
            figures['value'].append(error.detach())
            if not learning:
                continue
            advantage = part.advantage
            if config.normalise_advantages and len(index) > 1:
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            log_prob, entropy = policy.log_prob_entropy(part.observation, part.action)
            log_ratio = log_prob - part.log_prob
            ratio = log_ratio.exp()
            kl = (ratio - 1 - log_ratio).mean().detach()
            figures['clipped'].append(((ratio - 1).abs() > config.clip_range).float())
            if 0 < config.target_kl < kl:
                learning = False
                continue
            objective = clipped_objective(ratio, advantage, config.clip_range)
            adams[0].zero_grad()
            (-objective.mean() - config.entropy_coefficient * entropy.mean()).backward()
            figures['norm'].append(clip_grad_norm_(policy.parameters(), config.max_grad_norm))
            adams[0].step()
            policy.constrain()
            figures['policy'].append(-objective.detach())
            figures['entropy'].append(entropy.detach())
    mean = {name: _mean(found) for name, found in figures.items()}
    return Diagnostics(
        policy_loss=mean['policy'], value_loss=mean['value'], entropy=mean['entropy'],
        approx_kl=float(kl), clipfrac=mean['clipped'],
        explained_variance=explained_variance(batch.value, batch.target),
        grad_norm=mean['norm'], updates=len(figures['norm']))


def _mean(values: list[Tensor]) -> float:
    return float(torch.cat([value.flatten() for value in values]).mean()) if values else math.nan
