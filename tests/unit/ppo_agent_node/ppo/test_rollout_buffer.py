# SPDX-License-Identifier: Apache-2.0
"""Roll-outs of several groups: each group has the samples that it would have alone."""
from __future__ import annotations

import torch
from torch import Tensor

from ppo_agent_node import random_streams
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.ppo.episode_rollout import EpisodeRollout
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.rollout_buffer import Batch
from ppo_agent_node.ppo.rollout_buffer import Rollout
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import fly

ROCKETS, STEPS = 4, 60
SEEDS = (5, 6)


def policy_of(world: str) -> Policy:
    """Return a small policy that acts with noise."""
    return Learner(make(world, ROCKETS).spec, load_preset(
        'default', world, hidden_sizes=[8], symmetry='none', log_std_init=-1.0)).policy


def fly_group(
    rollout: Rollout | EpisodeRollout, world: str, policy: Policy, group: int, seed: int,
) -> None:
    """Fly a group from the starts of its seed, with noise of that seed."""
    limit = {'time_limit': 0.5} if world == 'lunar_lander' else {}
    fly(make(world, ROCKETS, **limit), rollout.flight(
        group, Reset(seed, {}), policy, random_streams.generator(seed, 'noise')))


def value(observation: Tensor) -> Tensor:
    """Return values that tell the observations apart."""
    return observation.sum(-1)


def samples(rollout: Rollout | EpisodeRollout) -> Batch:
    """Return the samples of all groups."""
    return rollout.batch(value, 0.999, 0.95, 1.0)


def test_two_groups_have_the_samples_of_two_roll_outs() -> None:
    policy = policy_of('lunar_lander')

    def begun(groups: int) -> Rollout:
        return Rollout(STEPS, ROCKETS, 8, policy, groups)

    both, alone = begun(2), [begun(1), begun(1)]
    for group, seed in enumerate(SEEDS):
        fly_group(both, 'lunar_lander', policy, group, seed)
        fly_group(alone[group], 'lunar_lander', policy, 0, seed)
    assert both.truncated.any(0).all()  # so that the values of final observations matter
    assert both.steps == 2 * STEPS * ROCKETS
    for found, *expected in zip(samples(both), *map(samples, alone), strict=True):
        by_step = [one.unflatten(0, (STEPS, ROCKETS)) for one in expected]
        assert not torch.equal(*by_step)
        assert torch.equal(found.unflatten(0, (STEPS, 2 * ROCKETS)), torch.cat(by_step, 1))


def test_two_groups_of_episodes_have_the_samples_of_two_roll_outs() -> None:
    policy = policy_of('rocket')
    both, alone = EpisodeRollout(ROCKETS, 2, 2), [EpisodeRollout(ROCKETS, 2) for _ in SEEDS]
    for group, seed in enumerate(SEEDS):
        fly_group(both, 'rocket', policy, group, seed)
        fly_group(alone[group], 'rocket', policy, 0, seed)
    found, expected = samples(both), [*map(samples, alone)]
    assert both.steps == sum(one.steps for one in alone)
    for name in ('observation', 'action', 'log_prob'):
        parts = [getattr(one, name) for one in expected]
        assert not torch.equal(*parts)
        assert torch.equal(getattr(found, name), torch.cat(parts))
    # Advantages have a common scale, so the groups' own ones differ from them by a factor each.
    whole = found.advantage.split([len(one.advantage) for one in expected])
    for together, one in zip(whole, expected, strict=True):
        ratio = together[one.advantage != 0] / one.advantage[one.advantage != 0]
        assert len(ratio) > 100
        torch.testing.assert_close(ratio, ratio[:1].expand_as(ratio))
