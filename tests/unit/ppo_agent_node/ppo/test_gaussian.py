# SPDX-License-Identifier: Apache-2.0
"""State-dependent exploration of the Gaussian policy."""
from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch

from ppo_agent_node import random_streams
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.ppo.episode_rollout import EpisodeRollout
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.rollout_buffer import Rollout
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import fly

ROCKETS = 4000


def policy(exploration: str = 'state_dependent', log_std: float = -1.0) -> GaussianPolicy:
    """Return a policy of six observations and two actions."""
    return GaussianPolicy(
        6, 2, (16, 12), random_streams.generator(1, 'policy'), log_std, exploration=exploration)


def noise_of(
    one: GaussianPolicy, seen: list[torch.Tensor], name: str = 'noise',
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the noise `(T, N, A)` of successive observations, and its log-probabilities."""
    log_prob = torch.empty(len(seen), len(seen[0]))
    sample = one.sampler(log_prob, random_streams.generator(1, name))
    return torch.stack([
        sample(step, observation) - one.mode(observation)
        for step, observation in enumerate(seen)]).detach(), log_prob


def test_noise_depends_on_the_state_alone_and_on_the_rocket() -> None:
    seen = torch.randn(64, 6, generator=random_streams.generator(2, 'seen'))
    other = torch.randn(64, 6, generator=random_streams.generator(3, 'seen'))
    noise, _ = noise_of(policy(), [seen, other, seen])
    torch.testing.assert_close(noise[0], noise[2])
    assert float((noise[0] - noise[1]).abs().mean()) > 0.1
    same = seen[:1].expand(64, 6)
    among_rockets, _ = noise_of(policy(), [same])
    assert float(among_rockets.std(1).min()) > 0.2
    independent, _ = noise_of(policy('independent'), [seen, other, seen])
    assert float((independent[0] - independent[2]).abs().mean()) > 0.1


def test_similar_states_have_similar_noise() -> None:
    seen = torch.randn(200, 6, generator=random_streams.generator(2, 'seen'))
    noise, _ = noise_of(policy(), [seen, seen + 1e-3])
    change = (noise[0] - noise[1]).abs().mean() / noise[0].abs().mean()
    assert float(change) < 0.01


def test_in_one_state_the_noise_is_normal_with_the_deviation_of_the_policy() -> None:
    seen = torch.full((ROCKETS, 6), 0.7)
    noise, _ = noise_of(policy(log_std=-2.0), [seen])
    deviation, error = math.exp(-2.0), 4 / math.sqrt(2 * ROCKETS)
    assert noise[0].std(0) / deviation == pytest.approx(1, abs=error)
    assert noise[0].mean(0) / deviation == pytest.approx(0, abs=4 / math.sqrt(ROCKETS))
    assert float(torch.corrcoef(noise[0].T)[0, 1]) == pytest.approx(0, abs=4 / math.sqrt(ROCKETS))
    inside = (noise[0].abs() < deviation).float().mean()
    assert float(inside) == pytest.approx(0.6827, abs=0.03)  # a normal distribution's


def test_log_probabilities_are_those_of_the_sampled_actions() -> None:
    one = policy()
    seen = torch.randn(50, 6, generator=random_streams.generator(2, 'seen'))
    log_prob = torch.empty(1, 50)
    action = one.sampler(log_prob, random_streams.generator(1, 'noise'))(0, seen)
    expected, _ = one.log_prob_entropy(seen, action)
    torch.testing.assert_close(log_prob[0], expected.detach())


def test_a_state_without_features_has_no_noise() -> None:
    one = policy()
    with torch.no_grad():
        for layer in one.mean.linear:
            layer.weight.zero_()
    noise, log_prob = noise_of(one, [torch.ones(3, 6)])
    assert not noise.any()
    assert torch.isfinite(log_prob).all()


def test_equal_streams_give_equal_noise_and_others_differ() -> None:
    seen = [torch.ones(8, 6)]
    first, again, other = (noise_of(policy(), seen, name)[0] for name in ('a', 'a', 'b'))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize('exploration', ['state_dependent', 'independent'])
def test_noise_is_drawn_once_for_an_episode_or_every_128_steps(
    exploration: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = make('rocket', 4, spawn_copies=2)
    policy = Learner(env.spec, load_preset(
        'default', hidden_sizes=[8], exploration=exploration)).policy
    drawn = []
    sampler = policy.sampler

    def counted(
        log_prob: torch.Tensor, generator: torch.Generator,
    ) -> Callable[[int, torch.Tensor], torch.Tensor]:
        drawn.append(log_prob.shape)
        return sampler(log_prob, generator)

    monkeypatch.setattr(policy, 'sampler', counted)
    finished, _ = fly(env, EpisodeRollout(4, 2).flight(
        0, Reset(5, {'spawn_copies': 2}), policy, random_streams.generator(1, 'test')))
    longest = max(step for step, _ in finished) + 1
    assert longest > 128
    assert len(drawn) == (1 if exploration == 'state_dependent' else math.ceil(longest / 128))


@pytest.mark.parametrize('exploration', ['state_dependent', 'independent'])
def test_log_probabilities_have_no_gradient(exploration: str) -> None:
    log_prob = torch.empty(1, 3)
    action = policy(exploration).sampler(
        log_prob, random_streams.generator(1, 'noise'))(0, torch.ones(3, 6))
    assert not log_prob.requires_grad
    assert not action.requires_grad


def test_a_roll_out_of_fixed_length_keeps_its_noise() -> None:
    """Also across the end of an episode, after which the same state has the same noise."""
    env = make('rocket', 4, time_limit=0.5)
    policy = Learner(env.spec, load_preset(
        'default', hidden_sizes=[8], exploration='state_dependent', log_std_init=-1.0)).policy
    rollout = Rollout(60, 4, env.spec.observation_size, policy)
    fly(env, rollout.flight(0, Reset(5, {}), policy, random_streams.generator(1, 'test')))
    assert rollout.terminated.any()
    expected = policy.sampler(torch.empty(60, 4), random_streams.generator(1, 'test'))
    for step, observation in enumerate(rollout.observation[:60]):
        assert torch.equal(rollout.action[step], expected(step, observation))
    log_prob, _ = policy.log_prob_entropy(
        rollout.observation[:60].flatten(0, 1), rollout.action.flatten(0, 1))
    torch.testing.assert_close(log_prob.detach(), rollout.log_prob.flatten())
