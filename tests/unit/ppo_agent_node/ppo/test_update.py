# SPDX-License-Identifier: Apache-2.0
"""The clipped objective by hand, and what one update does."""
from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import pytest
import torch

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import PPOConfig
from ppo_agent_node.ppo import losses
from ppo_agent_node.ppo import parallel
from ppo_agent_node.ppo import update
from ppo_agent_node.ppo.networks import backpropagation
from ppo_agent_node.ppo.networks.mlp import Critic
from ppo_agent_node.ppo.policies.factory import CategoricalPolicy
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.rollout_buffer import Batch
from ppo_agent_node.threads import tensor_threads

CONFIG = PPOConfig(
    n_epochs=2, batch_size=64, clip_range=0.2, target_kl=0.0, normalise_advantages=True)


@pytest.mark.parametrize(('ratio', 'advantage', 'value', 'slope'), [
    (1.0, 2.0, 2.0, 2.0), (1.1, 2.0, 2.2, 2.0), (1.5, 2.0, 2.4, 0.0), (0.5, 2.0, 1.0, 2.0),
    (1.0, -2.0, -2.0, -2.0), (0.9, -2.0, -1.8, -2.0), (0.5, -2.0, -1.6, 0.0),
    (1.5, -2.0, -3.0, -2.0),
])
def test_clipped_objective_and_its_gradient(
    ratio: float, advantage: float, value: float, slope: float,
) -> None:
    r = torch.tensor([ratio], requires_grad=True)
    objective = losses.clipped_objective(r, torch.tensor([advantage]), 0.2)
    objective.sum().backward()
    assert float(objective.detach()) == pytest.approx(value)
    assert float(r.grad) == pytest.approx(slope)


@pytest.mark.parametrize(('value', 'error', 'slope'), [
    # The critic said 1 and should have said 3; it may move by 0.5 at once.
    (1.0, 4.0, -4.0), (1.4, 2.56, -3.2), (1.6, 2.25, 0.0), (3.0, 2.25, 0.0), (0.4, 6.76, -5.2),
    (4.4, 2.25, 0.0), (4.6, 2.56, 3.2),
])
def test_clipped_value_error_and_its_gradient(value: float, error: float, slope: float) -> None:
    v = torch.tensor([value], requires_grad=True)
    found = losses.squared_error(v, torch.tensor([1.0]), torch.tensor([3.0]), 0.5)
    found.sum().backward()
    assert float(found.detach()) == pytest.approx(error)
    assert float(v.grad) == pytest.approx(slope, abs=1e-6)


def test_unclipped_value_error_is_the_plain_one() -> None:
    v, old, target = torch.randn(3, 20)
    assert torch.equal(losses.squared_error(v, old, target, 0.0), (v - target).square())
    assert bool((losses.squared_error(v, old, target, 0.1) >= (v - target).square()).all())


def test_policy_gradient_by_hand() -> None:
    """d/d mu of -E[min(r A, clip(r) A)] for one linear layer: -r A (a - mu) / sigma^2 x."""
    policy = GaussianPolicy(1, 1, (), random_streams.generator(1, 'p'), log_std_init=math.log(0.5))
    with torch.no_grad():
        policy.mean[0].weight.fill_(0.3)
    x = torch.tensor([[1.0], [2.0], [-1.0]])
    a = torch.tensor([[0.5], [0.2], [0.4]])
    old = policy.log_prob_entropy(x, a)[0].detach() - torch.tensor([0.0, 0.1, 0.9])
    advantage = torch.tensor([1.0, -2.0, 3.0])
    ratio = (policy.log_prob_entropy(x, a)[0] - old).exp()
    (-losses.clipped_objective(ratio, advantage, 0.2).mean()).backward()
    expected = 0.0
    for index, weight in enumerate((1.0, math.exp(0.1), 0.0)):  # the last one is clipped away
        residual = float(a[index, 0]) - 0.3 * float(x[index, 0])
        expected -= weight * float(advantage[index]) * residual / 0.25 * float(x[index, 0]) / 3
    assert float(policy.mean[0].weight.grad) == pytest.approx(expected, rel=1e-5)


def setup(seed: int = 1, units: int = 16) -> tuple[GaussianPolicy, Critic, Batch]:
    policy = GaussianPolicy(
        4, 2, (units,), random_streams.generator(seed, 'p'), log_std_init=-1.0)
    critic = Critic(4, (units,), random_streams.generator(seed, 'c'))
    noise = random_streams.generator(seed, 'n')
    observation = torch.randn(256, 4, generator=noise)
    with torch.no_grad():
        action, log_prob = policy.sample(observation, noise)
        value = critic(observation)
    return policy, critic, Batch(
        observation, action, log_prob, action[:, 0].clone(), value + 1, value)


def run(
    seed: int = 1, shuffle: int = 1, train_policy: bool = True,
    poll: Callable[[], None] = lambda: None, train_critic: bool = True, units: int = 16,
    **changes: object,
) -> tuple[GaussianPolicy, Critic, update.Diagnostics, Batch]:
    policy, critic, batch = setup(seed, units)
    config = dataclasses.replace(CONFIG, **changes)
    diagnostics = update.update(
        update.PolicyUpdate(policy, config), update.CriticUpdate(critic, config), batch,
        random_streams.generator(shuffle, 'm'), (1e-3, 1e-3), 1e-3, train_policy, poll,
        train_critic=train_critic)
    return policy, critic, diagnostics, batch


def test_an_update_improves_both_networks_and_returns_figures() -> None:
    policy, critic, diagnostics, batch = run()
    start = setup()[0]
    assert policy.mode(batch.observation)[:, 0].mean() > start.mode(batch.observation)[:, 0].mean()
    assert (critic(batch.observation) - batch.target).abs().mean() < 1
    assert diagnostics.updates == 8
    assert diagnostics.entropy == pytest.approx(
        2 * (0.5 + 0.5 * math.log(2 * math.pi) - 1), abs=0.02)
    assert 0 < diagnostics.approx_kl < 0.05
    assert 0 <= diagnostics.clipfrac < 0.5
    assert diagnostics.explained_variance == pytest.approx(1, abs=1e-5)  # off by a constant
    assert math.isfinite(diagnostics.policy_loss)
    assert diagnostics.value_loss < 0.5


def test_value_clipping_holds_the_critic_back() -> None:
    """The target is 1 above: without clipping the critic gets there, with it a little way."""
    moved = []
    for clip_range in (0.0, 0.05):
        _, critic, _, batch = run(n_epochs=60, value_clip_range=clip_range)
        with torch.no_grad():
            moved.append((critic(batch.observation) - batch.value).mean())
    assert moved[0] > 0.8
    assert 0.04 < moved[1] < 0.3


def test_layers_that_are_not_trained_keep_their_bits() -> None:
    hidden, last = setup()[0].network.linear
    same, trained = run(trained_layers=1)[0].network.linear
    assert torch.equal(hidden.weight, same.weight)
    assert torch.equal(hidden.bias, same.bias)
    assert not torch.equal(last.weight, trained.weight)


def test_an_update_of_a_categorical_policy() -> None:
    policy = CategoricalPolicy(4, 3, (16,), random_streams.generator(1, 'p'))
    critic = Critic(4, (16,), random_streams.generator(1, 'c'))
    noise = random_streams.generator(1, 'n')
    observation = torch.randn(256, 4, generator=noise)
    with torch.no_grad():
        action, log_prob = policy.sample(observation, noise)
        value = critic(observation)
        before = policy.log_prob_entropy(observation, torch.full_like(action, 2))[0].exp().mean()
    batch = Batch(observation, action, log_prob, (action == 2).float(), value, value)
    diagnostics = update.update(
        update.PolicyUpdate(policy, CONFIG), update.CriticUpdate(critic, CONFIG), batch,
        random_streams.generator(1, 'm'), (1e-2,), 1e-3)
    with torch.no_grad():
        after = policy.log_prob_entropy(observation, torch.full_like(action, 2))[0].exp().mean()
    assert before == pytest.approx(1 / 3, abs=0.01)
    assert after > before + 0.02
    assert diagnostics.updates == 8
    assert diagnostics.entropy == pytest.approx(math.log(3), abs=0.05)
    assert 0 < diagnostics.approx_kl < 0.1


def test_equal_shuffles_are_equal_and_others_differ() -> None:
    first, again, other = (run(shuffle=s)[0].mean[0].weight for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_warm_up_trains_the_critic_only() -> None:
    policy, critic, diagnostics, _ = run(train_policy=False)
    start = setup()
    assert torch.equal(policy.mean[0].weight, start[0].mean[0].weight)
    assert not torch.equal(critic.value[0].weight, start[1].value[0].weight)
    assert diagnostics.updates == 0
    assert math.isnan(diagnostics.policy_loss)
    assert math.isnan(diagnostics.approx_kl)


def test_divergence_ends_the_update() -> None:
    _, _, diagnostics, _ = run(target_kl=1e-9)
    assert diagnostics.updates == 1
    assert diagnostics.approx_kl > 1e-9


def test_entropy_bonus_widens_the_policy() -> None:
    plain, bold = run()[0], run(entropy_coefficient=10.0)[0]
    assert bool((bold.log_std > plain.log_std).all())


@pytest.mark.parametrize('train_critic', [True, False])
@pytest.mark.parametrize('threads', [1, 2])
def test_an_update_is_polled_before_each_minibatch_and_can_be_ended(
    threads: int, train_critic: bool,
) -> None:
    polls = 0

    def stop() -> None:
        nonlocal polls
        polls += 1
        if polls == 5:
            raise KeyboardInterrupt

    with tensor_threads(threads):
        with pytest.raises(KeyboardInterrupt):
            run(poll=stop, train_critic=train_critic)
        assert polls == 5
        assert torch.get_num_threads() == threads
        run(poll=stop, train_critic=train_critic)
        assert polls >= 5 + 8  # at least once for each of the policy's minibatches


@pytest.mark.parametrize(('train_policy', 'train_critic'), [
    (True, True), (False, True), (True, False)])
@pytest.mark.parametrize('units', [16, 32])  # two ways to compute tanh
def test_one_thread_and_two_are_equal_bit_for_bit(
    train_policy: bool, train_critic: bool, units: int, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(backpropagation, '_CACHED_ROWS', 24)  # three pieces of each minibatch
    found = []
    for threads in (1, 2):
        with tensor_threads(threads):
            policy, critic, diagnostics, _ = run(
                train_policy=train_policy, train_critic=train_critic, units=units)
            found.append((*policy.parameters(), *critic.parameters(), torch.tensor(
                list(dataclasses.astuple(diagnostics))).nan_to_num()))
    assert all(torch.equal(one, two) for one, two in zip(*found, strict=True))


def test_halves_of_a_minibatch_are_added(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run()[0]
    critic, results = setup()[1], []
    for rows in (24, 64):  # three pieces of each minibatch, and one
        monkeypatch.setattr(backpropagation, '_CACHED_ROWS', rows)
        halved, untouched, diagnostics, _ = run(train_critic=False)
        assert torch.allclose(halved.mean[0].weight, whole.mean[0].weight, atol=1e-6)
        assert torch.allclose(halved.log_std, whole.log_std, atol=1e-6)
        assert torch.equal(untouched.value[0].weight, critic.value[0].weight)
        results.append(diagnostics)
    assert results[0].policy_loss == pytest.approx(results[1].policy_loss, abs=1e-6)
    assert results[0].grad_norm == pytest.approx(results[1].grad_norm, rel=1e-5)


def test_an_error_in_a_half_ends_the_update(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backpropagation, '_CACHED_ROWS', 24)
    add = update.PolicyGradient.add
    for failing in ((0,), (1,), (0, 1)):
        calls: list[update.PolicyGradient] = []

        def fail(self: update.PolicyGradient, *given: object, failing: object = failing,
                 calls: list = calls) -> None:
            if id(self) not in map(id, calls):
                calls.append(self)
            # The second half is begun first.
            if [id(one) for one in calls].index(id(self)) in failing:
                raise MemoryError('no gradient')
            add(self, *given)

        monkeypatch.setattr(update.PolicyGradient, 'add', fail)
        for threads in (1, 2):
            calls.clear()
            with tensor_threads(threads):
                with pytest.raises(MemoryError, match='no gradient'):
                    run(train_critic=False)
                assert torch.get_num_threads() == threads


@pytest.mark.parametrize('threads', [1, 2])
def test_an_error_in_the_second_half_is_raised(threads: int) -> None:
    def fail() -> None:
        raise MemoryError('second half')

    with tensor_threads(threads):
        with parallel.second_thread() as begin, pytest.raises(MemoryError, match='second half'):
            begin(fail)()
        assert torch.get_num_threads() == threads


def test_explained_variance() -> None:
    target = torch.tensor([1.0, 2.0, 3.0])
    assert update.explained_variance(target, target) == 1
    assert update.explained_variance(torch.zeros(3), target) == 0
    assert update.explained_variance(-target, target) == -3
    assert math.isnan(update.explained_variance(target, torch.ones(3)))
