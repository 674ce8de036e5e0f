# SPDX-License-Identifier: Apache-2.0
"""Training with discrete actions, without levels, from scratch: results and output."""
from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.image import imread
from support.training.line_world import LEFT
from support.training.line_world import RIGHT
from support.training.line_world import LineWorld
from support.training.line_world import walker
from support.training.training_runs import left_by

from ppo_agent_node import random_streams
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.flying.episodes import scatter
from ppo_agent_node.imitation.demonstrations import fly_wave
from ppo_agent_node.imitation.demonstrations import start_settings
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.teacher import scripted_teacher
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.policies.factory import CategoricalPolicy
from ppo_agent_node.ppo.rollout_buffer import Rollout
from ppo_agent_node.reporting.pictures.catalogue import draw
from ppo_agent_node.reporting.run_files import load
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.episode_scores import ScoreLines
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.stop_criterion import Result
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import fly

SMALL: dict[str, Any] = {
    'demonstration_episodes': 0, 'curriculum_start_level': 0, 'curriculum_final_level': 0,
    'hidden_sizes': (16,), 'activation': 'relu', 'fine_observations': '', 'iterations': 12,
    'n_steps': 32, 'scatter_steps': 7, 'n_epochs': 4, 'batch_size': 64, 'clip_range': 0.2,
    'value_clip_range': 0.5, 'gamma': 0.97, 'gae_lambda': 0.9, 'entropy_coefficient': 0.001,
    'actor_learning_rate': 1e-2, 'critic_learning_rate': 1e-2, 'learning_rate_decay': False,
    'target_kl': 0.0, 'reward_scale': 0.1, 'critic_warmup_iterations': 0, 'threads': 1,
    'checkpoint_interval': 4, 'selection_interval': 6, 'selection_episodes': 16,
    'episode_lines': True,
}


def train(
    path: Path, stop_after: int = -1, resume: bool = False, expert: Any = None,
    said: list[str] | None = None, statuses: list[Status] | None = None, **changes: Any,
) -> Result:
    """Train in the line world; stop at the given poll, if any."""
    polls = 0

    def stop() -> bool:
        nonlocal polls
        polls += 1
        return polls == stop_after

    return Trainer(
        SerialFleet(LineWorld()), make_config({**SMALL, **changes}), RunFolder(path, resume),
        (statuses if statuses is not None else []).append, expert=expert,
        stop_requested=stop, say=(said if said is not None else []).append).run()


@pytest.fixture(scope='module')
def straight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Return the folder of an undisturbed run, and its output."""
    path, said = tmp_path_factory.mktemp('runs') / 'run', []
    assert train(path, said=said).finished
    return path, said


def test_training_learns_to_walk(straight: tuple[Path, list[str]]) -> None:
    lines = RunFolder(straight[0], resume=True).lines()
    assert {line['stage'] for line in lines} == {'finetune'}
    assert lines[1]['mean_return'] < 0
    assert 'selection_return' not in lines[0], 'what has learnt nothing was flown'
    assert lines[-1]['selection_return'] > 9
    assert lines[-1]['selection_landing_rate'] == 1
    assert 'log_std' not in lines[-1]
    pilot = PolicyPilot(straight[0] / 'policy.safetensors', LineWorld().spec)
    action = pilot(np.array([[1.0, 0.0], [-1.0, 0.0]], np.float32))
    assert (action.dtype, action.tolist()) == (np.int64, [LEFT, RIGHT])
    content = tensor_file.read(straight[0] / 'policy.safetensors', 'policy').content
    assert content['activation'] == 'relu'
    result = evaluate(LineWorld(), pilot, 100, 5)
    assert summarise(result)['outcomes'] == {
        'landed': 100, 'crashed': 0, 'out_of_bounds': 0, 'timeout': 0}


def test_equal_seeds_are_equal_and_others_differ(
        straight: tuple[Path, list[str]], tmp_path: Path) -> None:
    train(tmp_path / 'run')
    assert left_by(tmp_path / 'run') == left_by(straight[0])
    train(tmp_path / 'other', seed=2)
    assert left_by(tmp_path / 'other')['log'] != left_by(straight[0])['log']


@pytest.mark.parametrize('polls', [60, 250, 400, 550])
def test_a_resumed_run_ends_the_same_with_the_same_output(
        straight: tuple[Path, list[str]], tmp_path: Path, polls: int) -> None:
    path, said = tmp_path / 'run', []
    assert not train(path, stop_after=polls, said=said).finished
    lines_before = len(said)
    assert train(path, resume=True, said=said).finished
    assert left_by(path) == left_by(straight[0])
    assert said == straight[1]
    assert lines_before < len(said)


def test_each_episode_has_its_line_and_its_score(
        straight: tuple[Path, list[str]], tmp_path: Path) -> None:
    lines = RunFolder(straight[0], resume=True).lines()
    scores = [score for line in lines for score in line.get('scores', ())]
    assert len(scores) == sum(line['episodes'] for line in lines[1:]) > 100
    for line in lines[1:]:
        assert np.mean(line['scores']) == pytest.approx(line['mean_return'])
    assert straight[1] == ScoreLines(0).add(scores)
    drawn = {picture.path.name: picture.path for picture in draw(load(straight[0]), tmp_path)}
    assert set(drawn) == {'training.png', 'diagnostics.png', 'score.png'}
    for path in drawn.values():
        ink = (imread(path)[..., :3] < 0.9).any(axis=-1).mean()
        assert 0.01 < ink < 0.6, path


def test_a_number_of_episodes_ends_a_run(straight: tuple[Path, list[str]], tmp_path: Path) -> None:
    path, said, statuses = tmp_path / 'run', [], []
    result = train(path, said=said, statuses=statuses, training_episodes=200)
    assert result.finished
    assert next(s for s in reversed(statuses) if math.isfinite(s.remaining)).remaining == 0
    assert 1 < result.iterations < SMALL['iterations']
    folder = RunFolder(path, resume=True)
    lines = folder.lines()
    assert len(said) >= 200 > len(said) - lines[-1]['episodes']
    assert said[199].startswith('episode: 200/200, score: ')
    # The last iteration has its flight without noise and its checkpoint, whatever the intervals.
    assert 'selection_return' in lines[-1]
    assert (path / 'checkpoints' / f'iteration_{result.iterations:06d}.safetensors').exists()
    # As far as it went, it was the same run.
    for line, other in zip(lines[:-1], RunFolder(straight[0], resume=True).lines(), strict=False):
        assert line.get('scores') == other.get('scores')
    assert train(path, resume=True, training_episodes=200).iterations == result.iterations


def test_reaching_the_target_return_ends_a_run(
        straight: tuple[Path, list[str]], tmp_path: Path) -> None:
    path = tmp_path / 'run'
    result = train(path, target_return=9.0, selection_interval=2)
    assert result.finished and result.best is not None
    assert result.best.iteration == result.iterations < SMALL['iterations']
    returns = [line['selection_return'] for line in RunFolder(path, resume=True).lines()
               if 'selection_return' in line]
    assert max(returns[:-1]) < 9 <= returns[-1] == result.best.mean_return
    # As far as it went, it was the same run.
    ours, other = (RunFolder(p, resume=True).lines() for p in (path, straight[0]))
    assert [line.get('scores') for line in ours] == [
        line.get('scores') for line in other[:len(ours)]]
    assert train(path, resume=True, target_return=9.0, selection_interval=2).iterations == (
        result.iterations)


def test_without_episode_lines_nothing_is_printed(tmp_path: Path) -> None:
    said: list[str] = []
    train(tmp_path / 'run', said=said, iterations=2, episode_lines=False)
    assert said == []
    assert not any('scores' in line for line in RunFolder(tmp_path / 'run', resume=True).lines())
    draw(load(tmp_path / 'run'), tmp_path)
    assert not (tmp_path / 'score.png').exists()


def test_a_pilot_can_be_imitated_but_has_to_be_given(tmp_path: Path) -> None:
    imitate = {'demonstration_episodes': 32, 'clone_epochs': 40, 'clone_batch_size': 16}
    with pytest.raises(ValueError, match=(
            r'demonstration_episodes: got 32, expected 0.*steers continuously.*line')):
        train(tmp_path / 'nobody', **imitate)
    assert train(tmp_path / 'run', expert=walker, iterations=0, **imitate).finished
    lines = RunFolder(tmp_path / 'run', resume=True).lines()
    losses = [line['clone_validation_loss'] for line in lines if line['stage'] == 'clone']
    assert losses[0] < 1.5
    assert min(losses) < 0.7 * losses[0]
    assert lines[-1]['selection_landing_rate'] == 1


def test_actor_and_critic_have_the_shape_of_the_settings() -> None:
    learner = Learner(LineWorld().spec, make_config({**SMALL, 'hidden_sizes': (12, 5, 3)}))
    for network, outputs in ((learner.policy, 4), (learner.critic, 1)):
        layers = [part for part in network.modules() if not list(part.children())][1:]
        assert [type(layer) for layer in layers[1::2]] == [torch.nn.ReLU] * 3
        assert [layer.out_features for layer in layers[::2]] == [12, 5, 3, outputs]


def test_roll_outs_hold_whole_numbers_and_their_probabilities() -> None:
    world = LineWorld(4)
    policy = CategoricalPolicy(2, 4, (8,), random_streams.generator(1, 'p'))
    rollout = Rollout(50, 4, 2, policy)
    world.reset(1)
    fly(world, rollout.flight(
        0, Restore(world.snapshot()), policy, random_streams.generator(1, 'noise')))
    assert (rollout.action.dtype, rollout.action.shape) == (torch.int64, (50, 4))
    assert set(rollout.action.unique().tolist()) == {0, 1, 2, 3}
    log_prob, _ = policy.log_prob_entropy(
        rollout.observation.flatten(0, 1), rollout.action.flatten())
    torch.testing.assert_close(log_prob, rollout.log_prob.flatten())


def test_scattered_walkers_are_in_all_phases() -> None:
    world = LineWorld(64)
    observation = fly(world, scatter(
        world.spec, world.reset(1), lambda seen: np.zeros(len(seen), np.int64), 20,
        np.random.default_rng(1)))
    assert len(np.unique(observation[:, 1])) > 5


def test_the_lunar_lander_trains_with_its_presets(tmp_path: Path) -> None:
    for name, landers in (('default', 4), ('from_scratch', 2), ('original', 2)):
        said: list[str] = []
        config = load_preset(
            name, 'lunar_lander', iterations=2, n_steps=120, selection_episodes=2, threads=1)
        world = worlds.make('lunar_lander', num_envs=landers, time_limit=4.0)
        path = tmp_path / name
        assert Trainer(
            SerialFleet(world), config, RunFolder(path), say=said.append).run().finished
        assert bool(said) == (name == 'original')
        pilot = PolicyPilot(path / 'policy.safetensors', world.spec)
        summary = summarise(evaluate(world, pilot, 4, 1))
        assert summary['level'] is summary['fuel_ratio'] is None
        assert sum(summary['outcomes'].values()) == 4
        json.dumps(summary, allow_nan=False)
    assert said[0].startswith('episode: 1/10000, score: ')


def test_the_lander_imitates_its_scripted_pilot(tmp_path: Path) -> None:
    world = worlds.make('lunar_lander', num_envs=16)
    config = load_preset(
        'quick', 'lunar_lander', demonstration_episodes=16, selection_episodes=2, threads=1,
        target_return=-1e9)
    assert Trainer(SerialFleet(world), config, RunFolder(tmp_path / 'run')).run().finished
    lines = [json.loads(line) for line in (
        tmp_path / 'run' / 'train.jsonl').read_text('utf-8').splitlines()]
    flown = {line['stage']: line['landing_rate'] for line in reversed(lines)
             if 'landing_rate' in line}
    assert flown['demonstrate'] > 0.7
    losses = [line['clone_validation_loss'] for line in lines if line['stage'] == 'clone']
    # The logarithm of 4 actions is 1.39; the pilot's are predictable.
    assert len(losses) == 12 and losses[-1] < 0.7
    assert lines[-1]['iteration'] == 0 and 'selection_return' in lines[-1]


def test_a_gain_that_the_landers_pilot_does_not_have_is_refused() -> None:
    spec = worlds.make('lunar_lander').spec
    with pytest.raises(ValueError, match=(
            'teacher_flare_rate: got 2, expected -1, as the pilot of lunar_lander has no gains')):
        scripted_teacher(spec, load_preset(
            'quick', 'lunar_lander', teacher_flare_rate=2.0).demonstration)
    with pytest.raises(ValueError, match="teacher: got 'expert', expected ''"):
        scripted_teacher(
            spec, load_preset('quick', 'lunar_lander', teacher='expert').demonstration)


@pytest.mark.parametrize('continuous', [False, True])
def test_demonstrations_of_the_lander_begin_below_their_reach(continuous: bool) -> None:
    world = worlds.make('lunar_lander', num_envs=4, continuous=continuous)
    config = load_preset('quick', 'lunar_lander', demonstration_spawn_reach=2.0)
    settings = start_settings(config.curriculum, config.demonstration)
    assert settings == {'spawn_reach': 2.0}
    samples, episodes = fly(world, fly_wave(
        world.spec, LunarHeuristic(world.spec), config.demonstration, settings, 1, 0))
    assert len(episodes) == 4
    assert (samples.observation[:, 1] < 0.4).all()


def test_a_resumed_run_in_the_lunar_lander_ends_the_same(tmp_path: Path) -> None:
    config = load_preset(
        'original', 'lunar_lander', iterations=4, n_steps=100, selection_interval=2,
        selection_episodes=2, hidden_sizes=(16,), n_epochs=2, threads=1)

    def run(path: Path, polls: int, resume: bool = False) -> bool:
        left = iter(range(polls))
        world = worlds.make('lunar_lander', num_envs=2, seed=polls, time_limit=3.0)
        return Trainer(
            SerialFleet(world), config, RunFolder(path, resume),
            stop_requested=lambda: next(left, None) is None).run().finished

    (tmp_path / 'a').mkdir()
    (tmp_path / 'b').mkdir()
    assert run(tmp_path / 'a' / 'run', 100_000)
    assert not run(tmp_path / 'b' / 'run', 520)
    assert run(tmp_path / 'b' / 'run', 100_000, resume=True)
    assert left_by(tmp_path / 'a' / 'run') == left_by(tmp_path / 'b' / 'run')
