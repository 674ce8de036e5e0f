# SPDX-License-Identifier: Apache-2.0
"""The policy's distribution against torch.distributions, and how networks begin."""
from __future__ import annotations

import math

import pytest
import torch
from torch.distributions import Independent
from torch.distributions import Normal
from torch.nn import functional

from ppo_agent_node import random_streams
from ppo_agent_node.ppo.networks import dense as dense_module
from ppo_agent_node.ppo.networks.dense import add_product
from ppo_agent_node.ppo.networks.dense import dense
from ppo_agent_node.ppo.networks.dense import product
from ppo_agent_node.ppo.networks.mlp import Critic
from ppo_agent_node.ppo.networks.mlp import Normaliser
from ppo_agent_node.ppo.networks.mlp import mlp
from ppo_agent_node.ppo.networks.mlp import quick
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.threads import tensor_threads


def policy(seed: int = 1, hidden: tuple[int, ...] = (32, 16), **options: float) -> GaussianPolicy:
    return GaussianPolicy(15, 3, hidden, random_streams.generator(seed, 'policy'), **options)


def test_log_prob_and_entropy_are_those_of_a_normal_distribution() -> None:
    one = policy()
    with torch.no_grad():
        one.log_std.copy_(torch.tensor([-2.0, 0.5, -0.3]))
    observation, action = torch.randn(7, 15), torch.randn(7, 3)
    reference = Independent(Normal(one.mode(observation), one.log_std.exp()), 1)
    log_prob, entropy = one.log_prob_entropy(observation, action)
    torch.testing.assert_close(log_prob, reference.log_prob(action))
    torch.testing.assert_close(entropy, reference.entropy())


def test_samples_come_with_their_log_prob_and_have_the_right_moments() -> None:
    one = policy(log_std_init=-1.0)
    observation = torch.randn(1, 15).expand(40_000, 15)
    action, log_prob = one.sample(observation, random_streams.generator(3, 'noise'))
    torch.testing.assert_close(
        log_prob, one.log_prob_entropy(observation, action)[0], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(
        action.mean(0), one.mode(observation[:1])[0], rtol=0, atol=5 * math.exp(-1) / 200)
    torch.testing.assert_close(action.std(0), torch.full((3,), math.exp(-1)), rtol=0.02, atol=0)


def test_equal_seeds_are_equal_and_others_differ() -> None:
    first, again, other = policy(1), policy(1), policy(2)
    for name, tensor in first.state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])
    assert not torch.equal(first.mean[0].weight, other.mean[0].weight)
    observation = torch.randn(4, 15)
    a, b, c = (first.sample(observation, random_streams.generator(s, 'x'))[0] for s in (1, 1, 2))
    assert torch.equal(a, b)
    assert not torch.equal(a, c)


def test_the_global_generator_is_left_alone() -> None:
    before = torch.get_rng_state()
    one = policy()
    one.sample(torch.zeros(2, 15), random_streams.generator(1, 'noise'))
    Critic(15, (8,), random_streams.generator(1, 'critic'))
    assert torch.equal(before, torch.get_rng_state())


def test_initial_weights_do_not_depend_on_the_number_of_threads() -> None:
    found = []
    for threads in (1, 2):
        with tensor_threads(threads):
            found.append(mlp((53, 128, 3), 1.0, random_streams.generator(1, 'x'))[0].weight)
    assert torch.equal(*found)


def test_weights_begin_orthogonal_and_actions_near_zero() -> None:
    net = mlp((15, 64, 64, 3), 0.01, random_streams.generator(1, 'x'))
    square = net[2].weight
    torch.testing.assert_close(square @ square.T, 2 * torch.eye(64), rtol=0, atol=1e-5)
    last = net[4].weight
    torch.testing.assert_close(last @ last.T, 1e-4 * torch.eye(3), rtol=0, atol=1e-8)
    assert not net[0].bias.any()


def test_activations() -> None:
    kinds = {name: mlp((2, 3, 3, 1), 1.0, random_streams.generator(1, 'x'), name)
             for name in ('tanh', 'relu')}
    assert [type(layer) for layer in kinds['tanh']][1::2] == [torch.nn.Tanh] * 2
    assert [type(layer) for layer in kinds['relu']][1::2] == [torch.nn.ReLU] * 2
    assert torch.equal(kinds['tanh'][0].weight, kinds['relu'][0].weight)
    critic = Critic(2, (3,), random_streams.generator(1, 'c'), 'relu')
    with torch.no_grad():
        critic.value[0].weight.copy_(torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]))
        critic.value[2].weight.copy_(torch.tensor([[1.0, 10.0, 100.0]]))
        assert critic(torch.tensor([[2.0, -3.0]])).tolist() == [2.0]
        assert critic(torch.tensor([[-2.0, 3.0]])).tolist() == [230.0]


def test_the_deviation_stays_between_floor_and_falling_ceiling() -> None:
    one = policy(log_std_init=-2.0, log_std_final=-3.0, log_std_floor=-3.5)
    for value, progress, expected in (
            (-9.0, 0.0, -3.5), (0.0, 0.0, -2.0), (0.0, 0.5, -2.5), (-2.7, 0.5, -2.7),
            (0.0, 1.0, -3.0)):
        with torch.no_grad():
            one.log_std.fill_(value)
        one.constrain(progress)
        assert one.diagnostics()['log_std'] == pytest.approx(expected)
    low = policy(log_std_init=-2.0, log_std_final=-6.0, log_std_floor=-3.5)
    low.constrain(1.0)
    assert low.diagnostics()['log_std'] == pytest.approx(-3.5)
    free = policy(log_std_init=-2.0, log_std_final=20.0)
    with torch.no_grad():
        free.log_std.fill_(1.0)
    free.constrain(1.0)
    assert free.diagnostics()['log_std'] == pytest.approx(1.0)


def test_imitation_forgives_overshoot_at_the_bounds_only() -> None:
    one = policy()
    output = torch.tensor([[1.5], [-1.5], [0.5]])
    inside, pull = one.imitation(output, torch.tensor([[1.0, -1.0, 0.5]]))
    assert float(inside) == 0
    assert not pull.any()
    wrong, pull = one.imitation(output, torch.tensor([[0.5, 1.0, 0.0]]))
    assert float(wrong) == pytest.approx((1.0**2 + 2.5**2 + 0.5**2) / 3)
    torch.testing.assert_close(pull[:, 0], 2 / 3 * torch.tensor([1.0, -2.5, 0.5]))


def test_normaliser() -> None:
    normaliser = Normaliser(2)
    samples = torch.randn(500, 2) * torch.tensor([3.0, 1e-6]) + torch.tensor([5.0, 1.0])
    normaliser.fit(samples)
    normal = normaliser(samples)
    torch.testing.assert_close(normal.mean(0), torch.zeros(2), rtol=0, atol=1e-3)
    assert float(normal[:, 0].std()) == pytest.approx(1, abs=1e-4)
    assert float(normal[:, 1].std()) < 0.01  # a constant is not blown up into noise


def test_entries_with_a_width_are_scaled_logarithmically() -> None:
    normaliser = Normaliser(2)
    normaliser.width[0] = 0.01
    seen = normaliser(torch.tensor([[1e-5, 3.0], [1.0, 3.0], [10.0, -3.0]]))
    assert float(seen[0, 0]) == pytest.approx(1e-3, rel=1e-4)  # linear near zero
    assert float(seen[2, 0] - seen[1, 0]) == pytest.approx(math.log(10), rel=1e-3)
    assert seen[:, 1].tolist() == [3.0, 3.0, -3.0]
    copied = Normaliser(2)
    copied.copy_from(normaliser)
    assert torch.equal(copied.width, normaliser.width)


def test_hidden_entries_are_0_and_copies_do_not_hide_them() -> None:
    normaliser, other = Normaliser(2), Normaliser(2)
    normaliser.hide(1)
    samples = torch.randn(500, 2) * 3 + 5
    assert not normaliser(samples)[:, 1].any()
    normaliser.fit(samples)
    assert not normaliser(samples)[:, 1].any()
    assert float(normaliser(samples)[:, 0].std()) == pytest.approx(1, abs=1e-4)
    other.copy_from(normaliser)
    torch.testing.assert_close(other(samples)[:, 1], samples[:, 1] - samples[:, 1].mean())
    normaliser.copy_from(other)
    assert not normaliser(samples)[:, 1].any()


@pytest.mark.parametrize('rows', [0, 1, 31, 32, 257])
@pytest.mark.parametrize(('inputs', 'outputs'), [(3, 31), (15, 32), (200, 65)])
@pytest.mark.parametrize('activation', ['tanh', 'relu'])
def test_dense_layers_in_float32(rows: int, inputs: int, outputs: int, activation: str) -> None:
    noise = random_streams.generator(1, 'x')
    x, weight = torch.randn(rows, inputs, generator=noise), torch.randn(
        outputs, inputs, generator=noise)
    bias = torch.randn(outputs, generator=noise)
    exact = getattr(torch, activation)(x.double() @ weight.double().T + bias)
    torch.testing.assert_close(
        dense(x, weight, bias, activation).double(), exact, rtol=1e-5, atol=1e-5)
    exact = x.T.double() @ x.double()
    torch.testing.assert_close(product(x.T, x).double(), exact, rtol=1e-5, atol=1e-4)
    total = torch.ones(inputs, inputs)
    add_product(total, x.T, x)
    torch.testing.assert_close(total.double(), 1 + exact, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize('rows', [1, 64])
@pytest.mark.parametrize('activation', ['tanh', 'relu'])
def test_dense_layers_propagate_nan(rows: int, activation: str) -> None:
    x = torch.zeros(rows, 4)
    x[-1, 0] = math.nan
    y = dense(x, torch.ones(64, 4), torch.zeros(64), activation)
    assert y[-1].isnan().all()
    assert not y[:-1].any()


@pytest.mark.parametrize('units', [8, 40, 64])
@pytest.mark.parametrize('rows', [2, 7, 37])
def test_an_activation_does_not_depend_on_its_place_in_the_batch(
        monkeypatch: pytest.MonkeyPatch, rows: int, units: int) -> None:
    # oneDNN computes batches of 32 rows or more, with other last bits than the rest.
    monkeypatch.setattr(dense_module, '_offered', False)
    # Without weights, only the activation can round; few numbers are rounded in two ways.
    for bias in (torch.arange(-64 * units, 64 * units) / (16 * units)).split(units):
        alone, batch = (
            dense(torch.zeros(count, 1), torch.zeros(units, 1), bias, 'tanh')
            for count in (1, rows))
        assert torch.equal(batch, alone.expand_as(batch))


def test_large_layers_and_products_are_left_to_one_dnn(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object, **named: object) -> None:
        raise AssertionError(arguments)

    monkeypatch.setattr(dense_module, '_offered', True)
    monkeypatch.setattr(functional, 'linear', refuse)
    monkeypatch.setattr(torch, 'addmm', refuse)
    dense(torch.zeros(64, 3), torch.zeros(40, 3), torch.zeros(40), 'tanh')
    dense(torch.zeros(8, 8, 3), torch.zeros(40, 3), torch.zeros(40), 'relu')
    for rows, units in ((31, 40), (64, 31), (31, 64)):
        with pytest.raises(AssertionError):
            dense(torch.zeros(rows, 3), torch.zeros(units, 3), torch.zeros(units), 'tanh')


@pytest.mark.parametrize('activation', ['tanh', 'relu'])
def test_both_libraries_compute_the_same_layer(
    monkeypatch: pytest.MonkeyPatch, activation: str,
) -> None:
    generator = random_streams.generator(1, 'x')
    x, weight, bias = (
        torch.randn(*size, generator=generator) for size in ((64, 9), (40, 9), (40,)))
    found = []
    for offered in (True, False):
        monkeypatch.setattr(dense_module, '_offered', offered)
        total = torch.ones(40, 64)
        add_product(total, weight, x.T)
        found.append((dense(x, weight, bias, activation), product(x, weight.T), total))
    for one_dnn, mkl in zip(*found, strict=True):
        torch.testing.assert_close(one_dnn, mkl, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('rows', [1, 20, 200])
@pytest.mark.parametrize('activation', ['tanh', 'relu'])
def test_in_flight_a_network_is_the_same_bit_for_bit(rows: int, activation: str) -> None:
    network = mlp((15, 64, 48, 3), 1.0, random_streams.generator(1, 'x'), activation)
    normaliser = Normaliser(15)
    normaliser.width[1] = 0.1
    x = torch.randn(rows, 15, generator=random_streams.generator(1, 'y'))
    normaliser.fit(x if rows > 1 else torch.randn(9, 15))
    output = quick(normaliser, network.without_gradients())
    with torch.no_grad():
        network[0].weight.mul_(1.5)
        assert torch.equal(output(x), network(normaliser(x)))


def test_networks_give_equal_outputs_with_and_without_gradients() -> None:
    for activation in ('tanh', 'relu'):
        network = mlp((15, 64, 48, 3), 1.0, random_streams.generator(1, 'x'), activation)
        x = torch.randn(100, 15, generator=random_streams.generator(1, 'y'))
        with torch.no_grad():
            found = network(x)
        torch.testing.assert_close(found, network(x).detach(), rtol=1e-5, atol=1e-5)
