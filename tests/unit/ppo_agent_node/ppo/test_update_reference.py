# SPDX-License-Identifier: Apache-2.0
"""The update by hand-written gradients does what autograd and torch's Adam do."""
from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import pytest
import torch
from support.training import ppo_reference

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import PPOConfig
from ppo_agent_node.ppo import losses
from ppo_agent_node.ppo import update
from ppo_agent_node.ppo.networks.mlp import Critic
from ppo_agent_node.ppo.policies.factory import CategoricalPolicy
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.rollout_buffer import Batch

SAMPLES, SIZE = 3000, 6
RATES = (3e-4, 1e-3, 1e-3)
CONFIG = PPOConfig(
    n_epochs=2, batch_size=700, clip_range=0.1, target_kl=0.0, entropy_coefficient=0.0,
    max_grad_norm=0.5)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Small products are slow when two threads share each."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def networks(kind: str, activation: str, hidden: tuple[int, ...] = (32, 24)) -> tuple[
        Policy, Critic]:
    noise = random_streams.generator(1, 'p')
    policy: Policy = CategoricalPolicy(SIZE, 4, hidden, noise, activation)
    if kind == 'gaussian':
        policy = GaussianPolicy(
            SIZE, 3, hidden, noise, -0.5, 20.0, activation=activation)
        with torch.no_grad():
            policy.log_std.copy_(torch.tensor([-0.5, -1.0, 0.2]))
    critic = Critic(SIZE, hidden, random_streams.generator(1, 'c'), activation)
    for network in (policy, critic):
        network.normaliser.width[1] = 0.1
        network.normaliser.fit(torch.randn(100, SIZE, generator=noise))
    return policy, critic


def fixed_batch(policy: Policy, critic: Critic) -> Batch:
    """Return samples of a policy that has moved since: ratios on both sides of the clip range."""
    noise = random_streams.generator(1, 'n')
    observation = torch.randn(SAMPLES, SIZE, generator=noise)
    with torch.no_grad():
        action, log_prob = policy.sample(observation, noise)
        value = critic(observation)
    log_prob += 0.15 * torch.randn(SAMPLES, generator=noise)
    advantage, error = torch.randn(2, SAMPLES, generator=noise)
    return Batch(observation, action, log_prob, 2 * advantage + 1, value + error, value)


@pytest.mark.parametrize('kind', ['gaussian', 'categorical'])
@pytest.mark.parametrize('activation', ['tanh', 'relu'])
@pytest.mark.parametrize('changes', [
    {}, {'value_clip_range': 0.3}, {'entropy_coefficient': 0.05}, {'target_kl': 0.012},
    {'normalise_advantages': False, 'max_grad_norm': 1e9}, {'batch_size': 2999},
    {'batch_size': 64, 'value_clip_range': 0.1, 'entropy_coefficient': 0.01, 'clip_range': 0.2},
    {'trained_layers': 1}, {'trained_layers': 2, 'max_grad_norm': 0.01}, {'trained_layers': 9},
], ids=str)
def test_losses_and_weights_are_those_of_autograd(
    kind: str, activation: str, changes: dict[str, Any],
) -> None:
    config = dataclasses.replace(CONFIG, **changes)
    policy, critic = networks(kind, activation)
    batch = fixed_batch(policy, critic)
    reference = copy.deepcopy(policy), copy.deepcopy(critic)
    adams = ppo_reference.optimisers(*reference, RATES)
    ours = update.PolicyUpdate(policy, config), update.CriticUpdate(critic, config)
    rates = RATES[:2] if kind == 'gaussian' else RATES[:1]
    for iteration in range(2):  # the second one with the optimisers' memory of the first
        diagnostics = update.update(
            *ours, batch, random_streams.generator(iteration, 'm'), rates, RATES[2])
        expected = ppo_reference.update(
            *reference, adams, batch, config, random_streams.generator(iteration, 'm'))
        for name, value in dataclasses.asdict(expected).items():
            # clipfrac counts, and rounding may move a ratio over the edge.
            close = 2.1 / SAMPLES if name == 'clipfrac' else 1e-6
            assert getattr(diagnostics, name) == pytest.approx(
                value, rel=1e-4, abs=close, nan_ok=True), (iteration, name)
    if config.target_kl:
        assert diagnostics.updates < 10
    moved = 0.0
    for mine, theirs, start in zip(
            (*policy.parameters(), *critic.parameters()),
            (p for network in reference for p in network.parameters()),
            (p for network in networks(kind, activation) for p in network.parameters()),
            strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-4, atol=2e-6)
        moved = max(moved, float((mine - start).abs().max().detach()))
    assert moved > 1e-3


@pytest.mark.parametrize('kind', ['gaussian', 'categorical'])
def test_gradients_in_double_precision(kind: str) -> None:
    """Distributions and objectives, against autograd, to 1e-10."""
    policy = networks(kind, 'tanh')[0].double()
    noise = random_streams.generator(2, 'n')
    rows = 4 if kind == 'categorical' else 3
    output = torch.randn(rows, 50, generator=noise, dtype=torch.float64, requires_grad=True)
    action = (torch.randint(4, (50,), generator=noise) if kind == 'categorical'
              else torch.randn(50, 3, generator=noise, dtype=torch.float64))
    weight = torch.randn(50, generator=noise, dtype=torch.float64)
    found = policy.likelihood(output, action)
    loss = (found.log_prob * weight).sum() + 0.3 * found.entropy.expand(50).sum()
    parameters = policy.noise_parameters()
    expected = torch.autograd.grad(loss, [output, *parameters])
    with torch.no_grad():
        error, by_noise = policy.likelihood_gradient(
            policy.likelihood(output, action), action, weight, 0.3)
    for mine, theirs in zip((error, *by_noise), expected, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-10, atol=1e-10)


def test_objective_and_error_gradients_are_those_of_autograd() -> None:
    noise = random_streams.generator(3, 'n')
    log_ratio, advantage, value, old, target = 0.3 * torch.randn(5, 4000, generator=noise)
    log_ratio.requires_grad_()
    losses.clipped_objective(log_ratio.exp(), advantage, 0.2).sum().backward()
    torch.testing.assert_close(
        losses.objective_gradient(log_ratio.detach().exp(), advantage, 0.2), log_ratio.grad)
    for clip_range in (0.0, 0.1, 0.5):
        v = value.clone().requires_grad_()
        losses.squared_error(v, old, target, clip_range).sum().backward()
        torch.testing.assert_close(
            2 * losses.error_gradient(value, old, target, clip_range), v.grad)


def test_nan_in_the_samples_is_not_hidden() -> None:
    """A clipped sample has no gradient; NaN must not count as clipped."""
    gradient = losses.objective_gradient(torch.tensor([math.nan, 1.0]), torch.ones(2), 0.2)
    assert math.isnan(gradient[0])
    policy, critic = networks('gaussian', 'tanh')
    batch = fixed_batch(policy, critic)
    batch.advantage[5] = math.nan
    update.update(update.PolicyUpdate(policy, CONFIG), update.CriticUpdate(critic, CONFIG), batch,
               random_streams.generator(1, 'm'), RATES[:2], RATES[2])
    assert not all(bool(p.isfinite().all()) for p in policy.parameters())
    assert all(bool(p.isfinite().all()) for p in critic.parameters())
