# SPDX-License-Identifier: Apache-2.0
"""The categorical policy against torch.distributions and by hand."""
from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from support.training.line_world import LineWorld
from torch.distributions import Categorical

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.ppo.policies.factory import CategoricalPolicy
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.ppo.policies.factory import without_noise
from rocket_sim_node import worlds


def policy(seed: int = 1) -> CategoricalPolicy:
    """Return a policy that prefers some actions to others."""
    one = CategoricalPolicy(8, 4, (16,), random_streams.generator(seed, 'policy'))
    with torch.no_grad():
        one.logits[-1].weight.mul_(200)
    return one


def fixed(*probabilities: float) -> CategoricalPolicy:
    """Return a policy with these probabilities, whatever it sees."""
    one = CategoricalPolicy(2, len(probabilities), (), random_streams.generator(1, 'policy'))
    with torch.no_grad():
        one.logits[-1].weight.zero_()
        one.logits[-1].bias.copy_(torch.tensor(probabilities).log())
    return one


def test_log_prob_and_entropy_are_those_of_a_categorical_distribution() -> None:
    one, observation = policy(), torch.randn(50, 8)
    action = torch.arange(50) % 4
    reference = Categorical(logits=one.logits(observation))
    log_prob, entropy = one.log_prob_entropy(observation, action)
    torch.testing.assert_close(log_prob, reference.log_prob(action))
    torch.testing.assert_close(entropy, reference.entropy())
    assert float(entropy.detach().std()) > 0.05  # the observations matter


def test_entropy_by_hand_and_when_nearly_certain() -> None:
    nothing = torch.zeros(1, 2)
    log_prob, entropy = fixed(0.5, 0.25, 0.25).log_prob_entropy(nothing, torch.tensor([1]))
    assert log_prob.tolist() == pytest.approx([math.log(0.25)])
    assert entropy.tolist() == pytest.approx([1.5 * math.log(2)])
    certain = fixed(0.5, 0.5)
    with torch.no_grad():
        certain.logits[-1].bias.copy_(torch.tensor([500.0, -500.0]))
    log_prob, entropy = certain.log_prob_entropy(nothing, torch.tensor([0]))
    assert (log_prob.tolist(), entropy.tolist()) == ([0.0], [0.0])
    assert certain.sample(nothing.expand(1000, 2), random_streams.generator(1, 'x'))[0].sum() == 0


def test_samples_have_the_right_frequencies_and_log_probs() -> None:
    probabilities = (0.6, 0.3, 0.099, 0.001)
    one, count = fixed(*probabilities), 200_000
    action, log_prob = one.sample(torch.zeros(count, 2), random_streams.generator(3, 'noise'))
    assert action.dtype == torch.int64
    assert action.shape == (count,)
    for index, p in enumerate(probabilities):
        found = float((action == index).float().mean())
        assert found == pytest.approx(p, abs=4 * math.sqrt(p * (1 - p) / count))
    torch.testing.assert_close(log_prob, torch.tensor(probabilities).log()[action])


def test_samples_depend_on_their_generator_alone() -> None:
    one, observation = policy(), torch.randn(300, 8)
    before = torch.get_rng_state()
    first, again, other = (
        one.sample(observation, random_streams.generator(seed, 'x'))[0] for seed in (1, 1, 2))
    assert torch.equal(before, torch.get_rng_state())
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    # The values drawn do not decide how far the stream moves on.
    after = [random_streams.generator(1, 'x') for _ in range(2)]
    one.sample(observation, after[0])
    fixed(0.97, 0.01, 0.01, 0.01).sample(torch.zeros(300, 2), after[1])
    assert torch.equal(after[0].get_state(), after[1].get_state())


def test_the_mode_is_the_likeliest_and_of_equals_the_first() -> None:
    nothing = torch.zeros(3, 2)
    assert fixed(0.2, 0.3, 0.5).mode(nothing).tolist() == [2, 2, 2]
    assert fixed(0.1, 0.3, 0.3, 0.3).mode(nothing).tolist() == [1, 1, 1]
    flown = without_noise(fixed(0.2, 0.8))(nothing.numpy())
    assert (flown.dtype, flown.tolist()) == ('int64', [1, 1, 1])


@pytest.mark.parametrize('poison', [float('nan'), float('inf')])
def test_weights_that_are_not_finite_are_refused(poison: float) -> None:
    one = policy()
    with torch.no_grad():
        one.logits[-1].bias[2] = poison
    for choose in (one.mode, lambda seen: one.sample(seen, random_streams.generator(1, 'x'))):
        with pytest.raises(ValueError, match='probabilities of row 0 are not finite'):
            choose(torch.zeros(2, 8))


def test_imitation_is_the_cross_entropy() -> None:
    one = fixed(0.5, 0.25, 0.25)
    with torch.no_grad():
        loss, _ = one.imitation(one.output(torch.zeros(2, 2)).T, torch.tensor([0, 2]))
    assert float(loss) == pytest.approx(math.log(2) + math.log(4))


def test_the_first_actions_are_nearly_equally_likely() -> None:
    one = CategoricalPolicy(8, 4, (64, 64), random_streams.generator(1, 'policy'))
    entropy = one.log_prob_entropy(torch.randn(100, 8), torch.zeros(100, dtype=torch.int64))[1]
    assert float(entropy.min().detach()) > math.log(4) - 1e-3
    assert one.noise_parameters() == []
    assert one.diagnostics() == {}


def test_the_kind_of_policy_follows_the_kind_of_action() -> None:
    network = NetworkConfig(hidden_sizes=(8,), activation='relu', log_std_init=-1.0)
    discrete = make_policy(LineWorld().spec, network, random_streams.generator(1, 'p'))
    assert isinstance(discrete, CategoricalPolicy)
    assert discrete.logits[-1].out_features == 4
    assert isinstance(discrete.logits[1], torch.nn.ReLU)
    continuous = make_policy(worlds.make('rocket').spec, network, random_streams.generator(1, 'p'))
    assert isinstance(continuous, GaussianPolicy)
    assert continuous.diagnostics() == {'log_std': -1.0}
    assert isinstance(continuous.mean[1], torch.nn.ReLU)
    tanh = make_policy(
        LineWorld().spec, dataclasses.replace(network, activation='tanh'), torch.Generator())
    assert isinstance(tanh, CategoricalPolicy)
    assert isinstance(tanh.logits[1], torch.nn.Tanh)
