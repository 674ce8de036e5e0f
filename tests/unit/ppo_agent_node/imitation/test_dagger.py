# SPDX-License-Identifier: Apache-2.0
"""DAgger and the wide level: what is flown, labelled, learnt and written down."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from typing import ClassVar

import numpy as np
import pytest
import torch

from ppo_agent_node.config.presets import preset_values
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.flying.episodes import Step
from ppo_agent_node.imitation.dagger import Imitation
from ppo_agent_node.imitation.demonstrations import Demonstrations
from ppo_agent_node.imitation.demonstrations import fly_clone
from ppo_agent_node.imitation.demonstrations import fly_wave
from ppo_agent_node.imitation.demonstrations import label
from ppo_agent_node.imitation.demonstrations import usable_engine
from ppo_agent_node.pilots.estimator.estimator import ExpertEstimator
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.hoverslam import HoverslamPilot
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.policies.factory import without_noise
from ppo_agent_node.reporting.pictures.training_curves import cloning_figure
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.metrics_logger import MetricsLogger
from rocket_sim_node import worlds
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import fly
from rocket_sim_node.worlds.rocket import conditions

SMALL: dict[str, Any] = {
    'demonstration_episodes': 16, 'demonstration_noise': 0.02, 'demonstration_spawn_angle': 5.0,
    'demonstration_spawn_position': 0.0, 'demonstration_spawn_speed': 0.0,
    'clone_epochs': 2, 'dagger_epochs': 1, 'clone_batch_size': 256,
    'features': 'descent', 'hidden_sizes': (32, 32), 'fine_observations': '', 'threads': 1,
    'seed': 7}


def world(rockets: int = 16) -> worlds.VectorEnv:
    return worlds.make(
        'rocket', num_envs=rockets, seed=0, level=7, spawn_height=30.0, time_limit=6.0)


def imitate(folder: Path, **changes: Any) -> tuple[Learner, list[dict[str, Any]], int]:
    """Return the learner, the log and the rocket steps of an imitation."""
    env, config = world(), make_config({**SMALL, **changes})
    learner, run = Learner(env.spec, config), RunFolder(folder, resume=False)
    imitation = Imitation(
        env.spec, config, ExpertPilot(env.spec), SerialFleet(env).fly,
        MetricsLogger(run, lambda status: None), lambda: None)
    imitation.teach(learner.policy)
    return learner, list(run.lines()), imitation.steps


def test_the_expert_labels_every_state_that_the_clone_came_to() -> None:
    """Crashes included: 8 rockets under a random pilot, none of which lands."""
    env = world(8)
    expert = ExpertPilot(env.spec)
    flight = fly(env, fly_clone(RandomPilot(env.spec, 1), {'level': 7}, 5))
    samples, episodes = label(env.spec, expert, [flight]), flight.episodes
    assert len(episodes) == 8 and not (episodes.outcome == 0).any()
    np.testing.assert_array_equal(
        np.bincount(samples.episode), episodes.length[np.argsort(episodes.row)])
    np.testing.assert_array_equal(samples.action, expert(samples.observation.numpy()))


def test_a_stateful_teacher_receives_the_flown_actions() -> None:
    """The clone lights the engine, and the teacher takes this into account."""
    env = worlds.make('rocket', num_envs=4, seed=0, level=1, conditions='hoverslam')
    teacher = HoverslamPilot(env.spec)

    def light(observation: F32) -> F32:
        return np.tile(np.array([0.4, 0.0, 0.0], np.float32), (len(observation), 1))

    samples = label(env.spec, teacher, [fly(env, fly_clone(light, {'level': 1}, 5))])
    first = np.flatnonzero(np.diff(samples.episode, prepend=-1))
    throttle = samples.action[:, 0].numpy()
    assert (throttle[first] == -1).all()
    # 60 % throttle is 0.2 on the scale of actions; an engine that burns is not put out.
    assert (throttle[first + 1] >= 0.2 - 1e-6).all()


def test_labels_after_the_last_ignition_are_not_learnt() -> None:
    """The clone lights the engine and shuts it down: there is no second ignition."""
    env = worlds.make('rocket', num_envs=2, seed=0, level=1)
    floored = conditions.settings('hoverslam')
    asked = iter(np.repeat([-1.0, 0.4, -1.0, 0.9], (5, 3, 4, 2000)).astype(np.float32))

    def blink(observation: F32) -> F32:
        return np.outer(np.full(len(observation), next(asked)), [1, 0, 0]).astype(np.float32)

    flight = fly(env, fly_clone(blink, {'level': 1, **floored}, 5))
    samples = label(env.spec, HoverslamPilot(env.spec.after_reset(floored)), [flight])
    episodes = flight.episodes
    assert (episodes.ignitions == 1).all() and (episodes.length > 100).all()
    # Unlit, lit, and the step that shuts it down.
    assert np.bincount(samples.episode).tolist() == [5 + 3 + 1] * 2


@pytest.mark.slow
def test_flights_are_labelled_together_as_one_by_one() -> None:
    """Also by a teacher with a memory, and if one flight is much longer than the other."""
    env = worlds.make('rocket', num_envs=5, seed=0, observation='extended')
    teacher = ExpertEstimator(env.spec)
    clone = without_noise(Learner(env.spec, make_config(SMALL)).policy)
    flights = [fly(env, fly_clone(clone, {'level': 7, 'spawn_height': height}, 3))
               for height in (20.0, 190.0, 60.0)]
    assert len({len(flight.steps) for flight in flights}) == 3
    together = label(env.spec, teacher, flights)
    alone = Demonstrations.join([label(env.spec, teacher, [flight]) for flight in flights])
    assert torch.equal(together.observation, alone.observation)
    assert torch.equal(together.episode, alone.episode)
    torch.testing.assert_close(together.action, alone.action, rtol=0, atol=1e-6)


@pytest.mark.parametrize(('ignitions', 'usable'), [
    (0, [1, 1, 1, 1, 1, 1, 1, 1]), (1, [1, 1, 1, 0, 0, 0, 0, 0]), (2, [1, 1, 1, 1, 1, 1, 0, 0]),
    (3, [1, 1, 1, 1, 1, 1, 1, 1])])
def test_an_engine_is_usable_until_its_last_ignition_has_ended(
        ignitions: int, usable: list[int]) -> None:
    """Off, lit, off, off, lit, off, lit, off: half a percent of thrust is none."""
    flown = np.array([-1.0, -0.97, -0.99, -1.0, 1.0, -0.99, 0.0, -1.0])
    steps = [Step(np.zeros((2, 15), np.float32), np.array([[a, 0, 0], [-1, 0, 0]]),
                  np.ones(2, np.bool_), Episodes.concatenate([]), np.zeros(0, np.int64))
             for a in flown]
    found = usable_engine(steps, {'ignitions': ignitions, 'throttle_cutoff': 0.01})
    assert found.tolist() == [[bool(one) for one in usable], [True] * 8]


class Remembering:
    """Steers nothing, and keeps the flown actions that it receives."""

    actions: ClassVar[list[F32]] = []  # of the class, as flights are flown by copies

    def __call__(self, observation: F32) -> F32:
        return np.zeros((len(observation), 3), np.float32)

    def flew(self, action: F32) -> None:
        self.actions.append(action.copy())


def test_a_stateful_teacher_receives_the_noisy_actions(monkeypatch: pytest.MonkeyPatch) -> None:
    env, flown = world(4), []
    step = env.step
    monkeypatch.setattr(env, 'step', lambda action: (flown.append(action.copy()), step(action))[1])
    Remembering.actions.clear()
    config = make_config({**SMALL, 'demonstration_noise': 0.2}).demonstration
    fly(env, fly_wave(env.spec, Remembering(), config, {'level': 7}, 1, 0))
    assert len(flown) > 50
    assert np.std(flown) == pytest.approx(0.2, rel=0.1)
    np.testing.assert_array_equal(Remembering.actions, flown)


def test_rounds_are_flown_by_the_clone_and_written_down(tmp_path: Path) -> None:
    _, lines, steps = imitate(tmp_path / 'run', dagger_rounds=2)
    cloned = [line for line in lines if line['stage'] == 'clone']
    assert [line['iteration'] for line in cloned] == [1, 2, 3, 4]
    rounds = [line for line in cloned if 'dagger_round' in line]
    assert [(line['iteration'], line['dagger_round']) for line in rounds] == [(2, 1), (3, 2)]
    assert all(line['episodes'] == 16 and line['samples'] > 16 for line in rounds)
    assert steps == lines[-1]['steps'] > lines[0]['steps']


def test_a_wide_level_is_demonstrated_as_often(tmp_path: Path) -> None:
    _, lines, _ = imitate(tmp_path / 'run', curriculum_wide_level=8, num_groups=2)
    assert [line['stage'] for line in lines].count('demonstrate') == 2


def test_the_wide_level_has_the_headings_of_the_others(tmp_path: Path) -> None:
    env = worlds.make('rocket_planar', num_envs=2)
    config = make_config({
        **SMALL, 'demonstration_spawn_heading': 180.0, 'curriculum_wide_level': 8,
        'num_groups': 2})
    run = RunFolder(tmp_path / 'run', resume=False)
    starts = Imitation(
        env.spec, config, ExpertPilot(env.spec), SerialFleet(env).fly,
        MetricsLogger(run, lambda status: None), lambda: None).starts(1)
    assert [(start['level'], start['spawn_heading']) for start in starts] == [(7, 180), (8, 180)]
    assert 'spawn_angle' in starts[0] and 'spawn_angle' not in starts[1]


@pytest.mark.slow
def test_equal_seeds_give_equal_clones_and_a_later_round_another(tmp_path: Path) -> None:
    one, _, _ = imitate(tmp_path / 'one', dagger_rounds=1)
    two, _, _ = imitate(tmp_path / 'two', dagger_rounds=1)
    other, _, _ = imitate(tmp_path / 'other', dagger_rounds=2)
    for name, weights in one.policy.state_dict().items():
        assert torch.equal(weights, two.policy.state_dict()[name]), name
    assert not torch.equal(one.policy.network.linear[0].weight,
                           other.policy.network.linear[0].weight)
    # All rounds are normalised by the first demonstrations.
    assert torch.equal(one.policy.normaliser.mean, other.policy.normaliser.mean)


@pytest.mark.parametrize(('error', 'loss', 'slope'), [
    (0.03, 0.03**2, 2 * 0.03), (-0.03, 0.03**2, -2 * 0.03),
    (0.5, 2 * 0.05 * 0.5 - 0.05**2, 2 * 0.05), (-0.5, 2 * 0.05 * 0.5 - 0.05**2, -2 * 0.05)])
def test_hubers_loss_is_squared_near_and_linear_far(
        error: float, loss: float, slope: float) -> None:
    policy = GaussianPolicy(2, 1, (4,), torch.Generator())
    output = torch.tensor([[0.1 + error]])
    found, gradient = policy.imitation(output, torch.tensor([[0.1]]), 0.05)
    assert float(found) == pytest.approx(loss, rel=1e-5)
    assert float(gradient) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize(('wanted', 'output', 'error'), [
    (-1.0, -1.1, 0.1), (-1.0, -1.3, 0.0), (1.0, 1.1, -0.1), (1.0, 1.3, 0.0), (0.5, 0.6, 0.1)])
def test_the_margin_moves_targets_at_a_bound_beyond_it(
        wanted: float, output: float, error: float) -> None:
    policy = GaussianPolicy(2, 1, (4,), torch.Generator())
    loss, gradient = policy.imitation(
        torch.tensor([[output]]), torch.tensor([[wanted]]), margin=0.2)
    assert float(loss) == pytest.approx(error**2, abs=1e-6)
    assert float(gradient) == pytest.approx(2 * error, abs=1e-6)


def test_the_teacher_flies_as_the_expert_unless_gentler_gains_are_given() -> None:
    assert make_config({}).demonstration.teacher_gains() == {}
    gentle = make_config(preset_values('original', 'rocket')).demonstration.teacher_gains()
    assert gentle['flare_rate'] == 3.0 and gentle['braking_share'] == 0.8


def test_groups_fly_the_curriculums_level_and_the_wide_one_in_turn() -> None:
    config = make_config({
        'curriculum_wide_level': 8, 'num_groups': 2, 'conditions': 'mix'}).curriculum
    assert config.reset_settings(3, 0)['level'] == 3
    assert config.reset_settings(3, 1)['level'] == 8
    assert config.reset_settings(3, 2)['level'] == 3
    assert config.reset_settings(3, 1)['dry_mass_factor_high'] == 1.05
    harsher = make_config({
        'curriculum_wide_level': 7, 'curriculum_wide_conditions': 'harsh', 'num_groups': 2,
        'conditions': 'mix'}).curriculum
    assert harsher.reset_settings(3, 0)['dry_mass_factor_high'] == 1.05
    assert harsher.reset_settings(3, 1)['dry_mass_factor_high'] == 1.08
    assert [settings['level'] for settings in config.selection_settings] == [7, 8]
    plain = replace(config, selection_wide=False)
    assert [settings['level'] for settings in plain.selection_settings] == [7]
    with pytest.raises(ValueError, match=r'num_groups: got 1, expected 2 or more'):
        make_config({'curriculum_wide_level': 8})


def test_the_picture_marks_the_clone_of_the_last_round() -> None:
    """Losses of earlier rounds may be smaller: they are of fewer samples, and easier ones."""
    lines = [
        {'stage': 'clone', 'iteration': 1, 'clone_loss': 0.2, 'clone_validation_loss': 0.1},
        {'stage': 'clone', 'iteration': 2, 'clone_loss': 0.5, 'clone_validation_loss': 0.4,
         'dagger_round': 1, 'landing_rate': 0.81},
        {'stage': 'clone', 'iteration': 3, 'clone_loss': 0.4, 'clone_validation_loss': 0.3}]
    (axes,) = cloning_figure(lines).axes
    (star,) = (line for line in axes.lines if line.get_label() == 'kept policy')
    assert (star.get_xdata().tolist(), star.get_ydata().tolist()) == ([3.0], [0.3])
    assert [text.get_text() for text in axes.texts] == ['81 % landed']
    assert axes.get_title() == 'Before its round of DAgger the clone lands 81 %'


def test_no_more_flights_are_learnt_from_than_are_asked_for() -> None:
    """Of 8 rockets the first 3 count, in demonstrations and in rounds of DAgger."""
    env, config = world(8), make_config({**SMALL, 'demonstration_episodes': 3}).demonstration
    expert = ExpertPilot(env.spec)
    shown, landings = fly(env, fly_wave(env.spec, expert, config, {'level': 1}, 1, 0))
    assert (landings.outcome == 0).all() and len(landings) == 8
    assert int(shown.episode.max()) == 2
    flight = fly(env, fly_clone(RandomPilot(env.spec, 1), {'level': 7}, 5))
    seen, flown = label(env.spec, expert, [flight], most=3), flight.episodes
    np.testing.assert_array_equal(
        np.bincount(seen.episode), flown.length[np.argsort(flown.row)][:3])
