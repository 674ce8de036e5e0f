# SPDX-License-Identifier: Apache-2.0
"""Demonstrations of landed episodes only, and the clone they make."""
from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from ppo_agent_node import random_streams
from ppo_agent_node.config.imitation_config import CloneConfig
from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.flying.episodes import Step
from ppo_agent_node.flying.episodes import scatter
from ppo_agent_node.imitation.cloning import CloneEpoch
from ppo_agent_node.imitation.cloning import CloningFailed
from ppo_agent_node.imitation.cloning import clone
from ppo_agent_node.imitation.cloning import split_by_episode
from ppo_agent_node.imitation.demonstrations import Demonstrations
from ppo_agent_node.imitation.demonstrations import fly_wave
from ppo_agent_node.imitation.demonstrations import spawn_settings
from ppo_agent_node.imitation.demonstrations import steered
from ppo_agent_node.imitation.demonstrations import touching
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.teacher import scripted_teacher
from ppo_agent_node.ppo.policies.factory import CategoricalPolicy
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.threads import tensor_threads
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.jobs import fly

CALM = DemonstrationConfig(demonstration_noise=0.0)


class Careless:
    """An expert that falls asleep in every rocket that starts left of the pad."""

    def __init__(self, world: Any) -> None:
        self.expert, self.asleep = ExpertPilot(world.spec), np.zeros(world.spec.num_envs, bool)
        self.begun = False

    def __call__(self, observation: F32) -> NDArray[Any]:
        if not self.begun:
            self.asleep, self.begun = observation[:, 0] < 0, True
        action = self.expert(observation)
        action[self.asleep] = -1
        return action


def test_only_landed_episodes_are_kept_whole_and_from_their_beginning() -> None:
    world = worlds.make('rocket', num_envs=12, seed=3, level=7)
    pilot = Careless(world)
    samples, episodes = fly(world, fly_wave(
        world.spec, pilot, CALM, spawn_settings(CALM, 7), 5, 0))
    again = worlds.make('rocket', num_envs=12, level=7)
    first = again.reset(random_streams.derived_seed(5, 'demonstrations', 0),
                        **spawn_settings(CALM, 7))
    asleep = first[:, 0] < 0
    landed = episodes.outcome == 0
    assert len(episodes) == 12
    assert 0 < landed.sum() < 12
    assert set(episodes.row[landed]) == set(np.flatnonzero(~asleep))
    lengths = episodes.length[landed][np.argsort(episodes.row[landed])]
    np.testing.assert_array_equal(np.bincount(samples.episode), lengths)
    begins = np.concatenate(([0], np.cumsum(lengths)[:-1]))
    np.testing.assert_allclose(samples.observation[begins, 1], 200 / 50)
    np.testing.assert_array_equal(samples.observation[begins], first[~asleep])
    expected = ExpertPilot(world.spec)(samples.observation.numpy())
    np.testing.assert_allclose(samples.action, expected, atol=1e-6)


def test_noise_is_flown_and_not_learnt() -> None:
    noisy = dataclasses.replace(CALM, demonstration_noise=0.05)
    world = worlds.make('rocket', num_envs=6, seed=3, level=1)
    expert = ExpertPilot(world.spec, braking_share=0.8)
    samples, episodes = fly(world, fly_wave(
        world.spec, expert, noisy, spawn_settings(noisy, 1), 5, 0))
    calm, _ = fly(world, fly_wave(
        world.spec, expert, CALM, spawn_settings(CALM, 1), 5, 0))
    again, _ = fly(world, fly_wave(
        world.spec, expert, noisy, spawn_settings(noisy, 1), 5, 0))
    assert len(episodes) == 6
    np.testing.assert_allclose(samples.action, expert(samples.observation.numpy()), atol=1e-6)
    assert not torch.equal(samples.observation[200], calm.observation[200])
    assert torch.equal(samples.observation, again.observation)


def test_spawn_is_as_wide_as_asked_for() -> None:
    config = DemonstrationConfig(
        demonstration_spawn_angle=-1, demonstration_spawn_position=9.0,
        demonstration_spawn_speed=-1, demonstration_spawn_spin=-1)
    assert spawn_settings(config, 7) == {'level': 7, 'spawn_position': 9.0}
    assert spawn_settings(config, 0) == {}


def test_episodes_are_split_not_samples() -> None:
    episode = torch.arange(20).repeat_interleave(7)
    training, validation = split_by_episode(episode, 0.25, random_streams.generator(1, 'split'))
    assert sorted([*training.tolist(), *validation.tolist()]) == list(range(140))
    assert len(episode[validation].unique()) == 5
    assert not set(episode[validation].tolist()) & set(episode[training].tolist())
    assert len(split_by_episode(episode, 0.0, random_streams.generator(1, 'split'))[1]) == 0


def linear_task() -> Demonstrations:
    noise = random_streams.generator(1, 'task')
    observation = torch.randn(4000, 15, generator=noise) * 3 + 1
    action = (0.1 * observation[:, :3]).clamp(-1, 1)
    return Demonstrations(observation, action, torch.arange(4000) // 100)


def run(seed: int = 1, **settings: Any) -> tuple[GaussianPolicy, list[CloneEpoch], float]:
    policy = GaussianPolicy(15, 3, (32, 32), random_streams.generator(1, 'policy'))
    epochs: list[CloneEpoch] = []
    config = CloneConfig(**{
        'clone_epochs': 5, 'clone_batch_size': 128, 'clone_learning_rate': 3e-3, **settings})
    least = clone(policy, linear_task(), config, seed, epochs.append)
    return policy, epochs, least


def test_cloning_learns_and_keeps_the_best_epoch() -> None:
    policy, epochs, least = run()
    assert [e.epoch for e in epochs] == [1, 2, 3, 4, 5]
    assert epochs[-1].clone_loss < 0.15 * epochs[0].clone_loss
    assert least == min(e.clone_validation_loss for e in epochs) < 0.005
    task = linear_task()
    _, held_out = split_by_episode(task.episode, 0.1, random_streams.generator(1, 'clone split'))
    with torch.no_grad():
        loss, _ = policy.imitation(
            policy.output(task.observation[held_out]).T, task.action[held_out])
    assert float(loss) / len(held_out) == pytest.approx(least, rel=1e-5)
    assert float(policy.log_std.detach().mean()) == pytest.approx(-2.4)


def test_cloning_stops_early_and_returns_to_the_best_epoch() -> None:
    _, epochs, least = run(
        clone_epochs=40, clone_learning_rate=0.3, clone_patience=2)  # far too large a step
    assert len(epochs) < 40
    best = min(range(len(epochs)), key=lambda i: epochs[i].clone_validation_loss)
    assert len(epochs) - 1 - best == 2
    assert least == epochs[best].clone_validation_loss


def test_equal_seeds_are_equal_and_others_differ() -> None:
    first, again, other = (run(seed, clone_epochs=1)[0].mean[0].weight for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize('size', [63, 100, 4096])
def test_one_and_two_threads_learn_the_same_bits(size: int) -> None:
    found = []
    for threads in (1, 2):
        with tensor_threads(threads):
            policy, epochs, _ = run(clone_epochs=2, clone_batch_size=size)
        found.append((policy.state_dict(), epochs))
    assert found[0][1] == found[1][1]
    for name, tensor in found[0][0].items():
        assert torch.equal(tensor, found[1][0][name]), name


def test_demonstrations_without_a_landing_are_refused() -> None:
    none = Demonstrations(torch.zeros(0, 15), torch.zeros(0, 3), torch.zeros(0, dtype=torch.long))
    policy = GaussianPolicy(15, 3, (4,), random_streams.generator(1, 'policy'))
    with pytest.raises(ValueError, match='none landed'):
        clone(policy, none, CloneConfig(), 1, lambda epoch: None)
    one = Demonstrations(torch.zeros(2, 15), torch.zeros(2, 3), torch.tensor([0, 0]))
    joined = Demonstrations.join([one, none, one])
    assert joined.episode.tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize('label', [torch.inf, torch.nan])
def test_a_clone_without_a_finite_loss_is_refused(label: float) -> None:
    policy = GaussianPolicy(15, 3, (4,), random_streams.generator(1, 'policy'))
    before = {name: tensor.clone() for name, tensor in policy.state_dict().items()}
    diverged = Demonstrations(
        torch.randn(40, 15, generator=random_streams.generator(1, 'x')),
        torch.full((40, 3), label), torch.arange(40) // 4)
    epochs: list[CloneEpoch] = []
    with pytest.raises(CloningFailed, match=(
            r'^clone_learning_rate: got 0\.002, expected one with which cloning has a finite ')):
        clone(policy, diverged, CloneConfig(clone_epochs=2), 1, epochs.append)
    assert len(epochs) == 2
    for name, tensor in policy.state_dict().items():
        assert torch.equal(tensor, before[name]), name


def test_the_teacher_is_the_expert_with_gains_from_the_settings() -> None:
    gains = DemonstrationConfig(teacher_flare_speed=0.3).teacher_gains()
    assert gains['flare_speed'] == 0.3
    settings = ExpertPilot(worlds.make('rocket').spec, **gains).settings
    assert settings.flare_speed == 0.3
    assert set(gains) <= set(dataclasses.asdict(settings))


@pytest.mark.parametrize(('gain', 'value', 'expected'), [
    ('braking_share', 0.05, '0.1 to 1'), ('flare_rate', 0.25, '0.5 to 1000 1/s')])
def test_a_gain_of_the_teacher_that_is_out_of_range_is_named(
        gain: str, value: float, expected: str) -> None:
    config = DemonstrationConfig(**{f'teacher_{gain}': value})
    with pytest.raises(ValueError, match=f'^teacher_{gain}: got {value}, expected {expected}$'):
        scripted_teacher(worlds.make('rocket').spec, config)


def test_scattered_rockets_are_in_all_phases_of_their_episodes() -> None:
    world = worlds.make('rocket', num_envs=64, seed=1, level=7)
    expert = ExpertPilot(world.spec)
    rng = np.random.default_rng(1)
    last = fly(world, scatter(world.spec, world.reset(3), expert, 400, rng))
    height = last[:, 1] * 50
    assert np.histogram(height, bins=4, range=(0, 200))[0].min() >= 5
    synchronous = worlds.make('rocket', num_envs=64, seed=1, level=7)
    observation = synchronous.reset(3)
    for _ in range(400):
        observation = synchronous.step(expert(observation))[0]
    assert np.ptp(observation[:, 1]) * 50 < 60
    unmoved = world.reset(3)
    assert (fly(world, scatter(world.spec, unmoved, expert, 0, rng)) == unmoved).all()


def test_actions_after_touchdown_are_not_learnt() -> None:
    """In `rocket_planar` the contact switch cuts the engine; in `rocket` all is flown."""
    world = worlds.make('rocket_planar', 12, seed=1)
    pilot = ExpertPilot(world.spec)
    samples, episodes = fly(world, fly_wave(
        world.spec, pilot, CALM, spawn_settings(CALM, 7), 5, 0))
    assert (episodes.outcome == 0).all()
    assert not touching(samples.observation.numpy(), world.spec.settings).any()
    # All of the flight is there, and of the 26 steps or more on the ground none.
    counts = np.bincount(samples.episode.numpy())
    length = episodes.length[np.argsort(episodes.row)]
    assert (counts <= length - 25).all()
    assert (counts >= length - 100).all()
    free = worlds.make('rocket_planar', 12, seed=1, engine_cutoff=False)
    none = np.zeros(0, np.int64)
    steps = [
        Step(free.observe(), np.zeros((12, 3)), np.ones(12, np.bool_), episodes, none)] * 3
    assert steered(steps, free.spec.settings).all()
    assert steered(steps, worlds.make('rocket', 12).spec.settings).all()


@pytest.mark.parametrize('kind', ['gaussian', 'categorical'])
def test_the_gradient_of_imitation_is_autograds(kind: str) -> None:
    noise = random_streams.generator(1, 'x')
    policy: Policy = GaussianPolicy(15, 3, (4,), noise)
    action = (1.5 * torch.randn(50, 3, generator=noise)).clamp(-1, 1)
    if kind == 'categorical':
        policy = CategoricalPolicy(15, 3, (4,), noise)
        action = torch.randint(3, (50,), generator=noise)
    output = (1.5 * torch.randn(3, 50, generator=noise)).requires_grad_()
    loss, found = policy.imitation(output, action)
    loss.backward()
    torch.testing.assert_close(found.detach(), output.grad)


def test_cloning_matches_the_adam_optimiser_of_torch() -> None:
    """The same minibatches by autograd, Adam and its cosine."""
    task, seed = linear_task(), 1
    found, _, _ = run(seed, clone_epochs=2, clone_validation_fraction=0.0)
    policy = GaussianPolicy(15, 3, (32, 32), random_streams.generator(1, 'policy'))
    policy.normaliser.fit(task.observation)
    adam = torch.optim.Adam(policy.parameters(), lr=3e-3)
    generators = [random_streams.generator(seed, 'clone epoch', k) for k in (1, 2)]
    orders = [torch.randperm(4000, generator=generator).split(128) for generator in generators]
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, 2 * len(orders[0]))
    for index in (*orders[0], *orders[1]):
        loss, _ = policy.imitation(policy.output(task.observation[index]).T, task.action[index])
        adam.zero_grad()
        (loss / len(index)).backward()
        adam.step()
        schedule.step()
    for name, tensor in policy.state_dict().items():
        torch.testing.assert_close(found.state_dict()[name], tensor, rtol=0, atol=1e-5)


def test_a_cloning_that_is_ended_half_way_leaves_the_policy_as_it_was() -> None:
    policy = GaussianPolicy(15, 3, (8,), random_streams.generator(1, 'policy'))
    before = {name: tensor.clone() for name, tensor in policy.state_dict().items()}

    polls = itertools.count()

    def poll() -> None:
        if next(polls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        clone(policy, linear_task(), CloneConfig(), 1, lambda epoch: None, poll)
    for name, tensor in policy.state_dict().items():
        assert torch.equal(tensor, before[name])
