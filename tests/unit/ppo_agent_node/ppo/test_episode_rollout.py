# SPDX-License-Identifier: Apache-2.0
"""Roll-outs of whole episodes: advantages among the copies of a start, and training by them."""
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.training.training_runs import SMALL
from support.training.training_runs import assert_same_run
from support.training.training_runs import log_without_times

from ppo_agent_node import random_streams
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.training_config import fit_copies
from ppo_agent_node.ppo.episode_rollout import EpisodeRollout
from ppo_agent_node.ppo.episode_rollout import relative_advantages
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node.worlds import VectorEnv
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Results
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import execute
from rocket_sim_node.worlds.jobs import fly

COPIES = {'start_copies': 4, 'desired_kl': 0.01, 'critic_warmup_iterations': 0}


def test_an_advantage_is_the_return_less_the_mean_of_the_other_copies() -> None:
    returns = np.array([1.0, 2.0, 6.0, 5.0, 5.0, 5.0])
    advantage = relative_advantages(returns, 3)
    # By hand: 1 - (2 + 6) / 2 and so on, over the deviation of the three.
    expected = np.array([-3.0, -1.5, 4.5]) / (returns[:3].std() + 0.02)
    assert advantage[3:].tolist() == [0.0, 0.0, 0.0]
    assert advantage[:3] / advantage[0] == pytest.approx(expected / expected[0])


def test_without_division_a_start_counts_by_how_much_its_copies_differ() -> None:
    returns = np.array([1.0, 2.0, 6.0, 5.0, 5.1, 5.2])
    advantage = relative_advantages(returns, 3, normalise=False)
    # By hand: 1 - (2 + 6) / 2 and so on.
    assert advantage / advantage[0] == pytest.approx(
        np.array([-3.0, -1.5, 4.5, -0.15, 0.0, 0.15]) / -3.0)


def test_a_start_that_always_fails_gives_no_advantage() -> None:
    lost, easy = np.full(4, -104.0), np.array([295.0, 295.1, 295.2, 295.3])
    advantage = relative_advantages(np.concatenate((lost, easy)), 4)
    assert not advantage[:4].any()
    assert np.sort(advantage[4:]).tolist() == advantage[4:].tolist()


@pytest.mark.parametrize('normalise', [True, False])
def test_one_crash_among_many_landings_is_limited(normalise: bool) -> None:
    returns = np.tile([295.0, 295.1, 295.2, 295.3], 20)
    returns[0] = -100.0
    advantage = relative_advantages(returns, 4, normalise)
    assert advantage.min() >= -4.0
    assert advantage.max() <= 4.0
    assert advantage.argmin() == 0


def test_equal_returns_give_no_advantage() -> None:
    assert not relative_advantages(np.full(8, 3.0), 4).any()


def test_copies_that_do_not_divide_the_rockets_are_refused() -> None:
    with pytest.raises(ValueError, match=r'start_copies: got 3, expected a divisor of .* 8'):
        EpisodeRollout(8, 3)


def recorded_late(env: VectorEnv, flight: Job[Any]) -> Any:
    """Run a job as over DDS: results are recorded when the next command has been sent."""
    waiting: list[tuple[Callable[[Results], None], Results]] = []
    answer: Any = None
    try:
        while True:
            command = flight.send(answer)
            for record, results in waiting:
                record(results)
            waiting = []
            if isinstance(command, Act):
                answer, *results = env.step(command.action)
                waiting.append((command.record, tuple(results)))
            else:
                answer = execute(env, command)
    except StopIteration as end:
        return end.value


@pytest.mark.parametrize('exploration', ['independent', 'state_dependent'])
def test_results_that_are_recorded_late_make_the_same_roll_out(exploration: str) -> None:
    env = make('rocket', 8, level=3)
    learner = Learner(env.spec, load_preset(
        'default', hidden_sizes=[8], log_std_init=-1.0, exploration=exploration))
    found = []
    for run in (fly, recorded_late):
        rollout = EpisodeRollout(8, 4)
        ended, state = run(env, rollout.flight(
            0, Reset(1, {'spawn_copies': 4}), learner.policy, torch.Generator().manual_seed(2)))
        batch = rollout.batch(learner.critic, 0.99, 0.95, 1.0)
        found.append([
            state, rollout.steps, *(tensor.numpy().tobytes() for tensor in batch),
            *((step, episodes.episode_return.tolist()) for step, episodes in ended)])
    assert found[0] == found[1]
    if exploration == 'independent':
        assert found[0][1] > 8 * 256  # random numbers are drawn 128 steps at a time


@pytest.mark.parametrize('exploration', ['independent', 'state_dependent'])
def test_a_roll_out_holds_each_first_episode_whole(exploration: str) -> None:
    env = make('rocket', 8, spawn_copies=4)
    learner = Learner(env.spec, load_preset(
        'default', hidden_sizes=[8], log_std_init=-1.0, exploration=exploration))
    rollout = EpisodeRollout(8, 4)
    finished, _ = fly(env, rollout.flight(
        0, Reset(5, {'spawn_copies': 4}), learner.policy, random_streams.generator(1, 'test')))
    batch = rollout.batch(lambda seen: seen[:, 0], 1.0, 0.9, 0.01)
    episodes = [one for _, found in finished for one in zip(
        found.row, found.length, found.episode_return, strict=True)]
    assert sorted(row for row, _, _ in episodes) == list(range(8))
    assert len(batch.value) == sum(length for _, length, _ in episodes)
    # All rockets fly on until the last first episode has ended.
    assert rollout.steps == 8 * max(length for _, length, _ in episodes)
    returns = np.array([total for _, _, total in sorted(episodes)])
    expected = relative_advantages(returns, 4).astype(np.float32)
    assert sorted(set(batch.advantage.tolist())) == sorted(set(expected.tolist()))
    # Discounted, the last step has the whole advantage and each one before it a share.
    discounted = rollout.batch(lambda seen: seen[:, 0], 0.99, 0.9, 0.01).advantage
    lengths = np.array([length for _, length, _ in sorted(episodes)])
    rows = [row for step in range(lengths.max()) for row in np.flatnonzero(lengths > step)]
    steps = [step for step in range(lengths.max()) for _ in np.flatnonzero(lengths > step)]
    assert discounted.numpy() == pytest.approx(
        expected[rows] * 0.99 ** (lengths[rows] - 1 - steps), rel=1e-5)
    # Steps of which less than a thousandth is left are no samples, but they were flown.
    short = rollout.batch(lambda seen: seen[:, 0], 0.5, 0.9, 0.01)
    assert len(short.value) == 8 * 10
    assert rollout.steps == 8 * lengths.max()
    kept = np.flatnonzero(lengths[rows] - 1 - steps < 10)
    assert torch.equal(short.observation, batch.observation[kept])
    assert torch.equal(short.action, batch.action[kept])
    assert torch.equal(short.log_prob, batch.log_prob[kept])
    assert short.advantage.numpy() == pytest.approx(
        expected[np.array(rows)[kept]] * 0.5 ** (lengths[rows] - 1 - steps)[kept], rel=1e-5)
    # The copies begin alike, and the policy says how likely its own actions were.
    assert len(torch.unique(batch.observation[:8], dim=0)) == 2
    log_prob, _ = learner.policy.log_prob_entropy(batch.observation, batch.action)
    torch.testing.assert_close(log_prob, batch.log_prob)


def train(
    run: Path, stop_at: str = 'never', resume: bool = False, **settings: object,
) -> Path:
    """Train a little, until a checkpoint is there, and return the folder."""
    values = {
        **SMALL, 'hidden_sizes': [16, 16], 'iterations': 3, 'demonstration_episodes': 0, **COPIES,
        **settings}
    Trainer(
        SerialFleet(make('rocket', num_envs=8, time_limit=8.0)), load_preset('default', **values),
        RunFolder(run, resume=resume),
        stop_requested=(run / 'checkpoints' / stop_at).exists).run()
    return run


@pytest.mark.slow
@pytest.mark.parametrize('settings', [
    {}, {'exploration': 'independent', 'normalise_starts': False}])
def test_training_by_copies_is_the_same_bits_again_and_after_a_resume(
        tmp_path: Path, settings: dict[str, Any]) -> None:
    whole = train(tmp_path / 'whole', **settings)
    assert_same_run(whole, train(tmp_path / 'again', **settings))
    parts = train(tmp_path / 'parts', stop_at='iteration_000002.safetensors', **settings)
    assert not (parts / 'checkpoints' / 'iteration_000003.safetensors').exists()
    assert_same_run(whole, train(parts, resume=True, **settings))
    # The policy has learnt, and its rate has been adapted.
    rates = [line['learning_rate'] for line in log_without_times(whole) if 'approx_kl' in line]
    assert len(rates) == 3
    assert rates[2] * 3 != pytest.approx(rates[0])


@pytest.mark.slow
@pytest.mark.parametrize('settings', [
    {'exploration': 'independent'}, {'normalise_starts': False}])
def test_a_training_depends_on_its_exploration_and_its_advantages(
        tmp_path: Path, settings: dict[str, Any]) -> None:
    plain, other = (
        [line['approx_kl'] for line in log_without_times(train(
            tmp_path / name, iterations=1, **asked)) if 'approx_kl' in line]
        for name, asked in (('plain', {}), ('other', settings)))
    assert len(plain) == len(other) == 1
    assert plain != other


@pytest.mark.parametrize(('rockets', 'copies'), [(8, 4), (6, 3), (3, 3), (10, 2)])
def test_as_many_copies_as_divide_the_rockets(
        tmp_path: Path, rockets: int, copies: int) -> None:
    config = load_preset('default', **{**SMALL, 'hidden_sizes': [4], **COPIES})
    assert fit_copies(config, rockets).ppo.start_copies == copies
    run = RunFolder(tmp_path / 'run')
    Trainer(SerialFleet(make('rocket', rockets, time_limit=1.0)), load_preset(
        'default', **{**SMALL, 'hidden_sizes': [4], 'demonstration_episodes': 0,
                      'iterations': 1, **COPIES}), run).run()
    assert run.read_config()['training']['start_copies'] == copies


@pytest.mark.parametrize(('rockets', 'copies'), [
    (250, 10), (225, 15), (255, 15), (100, 10), (257, 1), (1, 1)])
def test_copies_are_the_largest_divisor(rockets: int, copies: int) -> None:
    assert fit_copies(load_preset('default'), rockets).ppo.start_copies == copies


def test_the_reverse_curriculum_and_copies_exclude_each_other() -> None:
    with pytest.raises(ValueError, match='start_copies: got 4, expected 1 with curriculum_start'):
        load_preset('from_scratch', start_copies=4)


def test_a_world_that_cannot_copy_starts_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"start_copies: got 2, .*'lunar_lander' has no spawn_c"):
        Trainer(SerialFleet(make('lunar_lander', 2)), load_preset(
            'default', 'lunar_lander', start_copies=2), RunFolder(tmp_path / 'run'))
