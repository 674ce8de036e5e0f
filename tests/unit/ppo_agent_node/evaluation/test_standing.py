# SPDX-License-Identifier: Apache-2.0
"""The standing rate of an evaluation: the contact model follows the ends of episodes."""
from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation import standing
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.evaluation.standing import _swing
from ppo_agent_node.evaluation.standing import after_touchdown
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.worlds.planar.settling import Settlement
from rocket_sim_node.worlds.rocket import rotation

SETTINGS = worlds.make('rocket').spec.settings


ONES = np.ones(4)


def ends(*states: tuple[float, float, float, float]) -> np.ndarray:
    """Last observations at (x m, speed along x m/s, lean to x deg, spin to x rad/s)."""
    observation = np.zeros((len(states), 15), np.float32)
    for row, (x, speed, tilt, spin) in enumerate(states):
        observation[row, :3] = np.array((x, 5.2, 0)) / 50
        observation[row, 3:6] = np.array((speed, -0.1, 0)) / 20
        angle = np.deg2rad(tilt)
        observation[row, 6:9] = (np.sin(angle), np.cos(angle), 0)
        observation[row, 11] = -spin / 10
    return observation


def test_a_swing_turns_up_into_the_nose() -> None:
    rng = np.random.default_rng(0)
    up = rng.standard_normal((50, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    quaternion = _swing(up)
    assert np.linalg.norm(quaternion, axis=1) == pytest.approx(1.0)
    turned = rotation.up_vector(quaternion.T).T
    assert turned == pytest.approx(up)
    assert (quaternion[:, 1] == 0).all()


def test_gentle_touchdowns_stand_and_fast_ones_do_not() -> None:
    """One that leans and turns on topples; 3.9 m/s is beyond the legs; the last is in the air."""
    found = after_touchdown(
        ends((3, 0, 0, 0), (0, 0, 40, 1.5), (0, 3.9, 0, 0), (0, 0, 0, 0)), np.full(4, 800.0),
        np.array((True, True, True, False)), SETTINGS, ONES, ONES)
    assert found.standing.tolist() == [True, False, False, False]
    assert found.verdicts == {'stands': 1, 'slides': 1, 'bounces': 0, 'tips_over': 1}
    assert found.rest_distance == pytest.approx([3.0], abs=0.01)


def test_landings_followed_in_parts_give_the_same_verdicts(
        monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    last = ends(*rng.uniform((-20, -4, -30, -1), (20, 4, 30, 1), (23, 4)).tolist())
    arguments = last, rng.uniform(500, 1500, 23), rng.random(23) < 0.8, SETTINGS, *np.ones((2, 23))
    whole = after_touchdown(*arguments)
    monkeypatch.setattr(standing, '_TOGETHER', 4)
    parts = after_touchdown(*arguments)
    assert (parts.verdicts, parts.verdict) == (whole.verdicts, whole.verdict)
    assert np.array_equal(parts.standing, whole.standing)
    assert parts.rest_distance == pytest.approx(whole.rest_distance, rel=1e-9)
    nobody = after_touchdown(last, arguments[1], np.zeros(23, np.bool_), *arguments[3:])
    assert not nobody.standing.any() and set(nobody.verdict) == {''}


@pytest.mark.parametrize('world', ['rocket', 'rocket_planar'])
def test_an_evaluation_reports_the_standing_rate(world: str) -> None:
    env = worlds.make(world, num_envs=20)
    summary = metrics.summarise(evaluate(env, scripted_pilot(env.spec), 20, 1))
    assert summary['standing_rate'] == 1.0
    assert summary['standing_rate_interval'][1] == 1.0
    line = next(x for x in metrics.table(summary).split('\n') if x.startswith('standing'))
    assert line.split()[1] == '100.00'
    if world == 'rocket':
        assert summary['settling'] == {'stands': 20, 'slides': 0, 'bounces': 0, 'tips_over': 0}
        assert summary['rest_distance']['p95'] < 0.05
    json.dumps(summary, allow_nan=False)


class Falling:
    """Leaves the engine off."""

    name = 'falling'

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return np.tile(np.array([-1, 0, 0], np.float32), (len(observation), 1))


def test_settling_uses_the_drawn_mass_and_gravity(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mass and gravity of each episode are those in the world's telemetry."""
    asked: list[tuple[np.ndarray, np.ndarray]] = []
    real = standing.settle

    def listen(*arguments: Any, gravity: np.ndarray, **others: Any) -> Settlement:
        asked.append((arguments[4], gravity))
        return real(*arguments, gravity=gravity, **others)

    monkeypatch.setattr(standing, 'settle', listen)
    env = worlds.make('rocket', num_envs=5)
    flown: list[Telemetry] = []
    step = env.step

    def record(action: np.ndarray) -> Any:
        answer = step(action)
        flown.append(env.finished)
        return answer

    monkeypatch.setattr(env, 'step', record)
    result = evaluate(
        env, Falling(), 20, 4, level=1, dry_mass_factor_low=0.9,
        dry_mass_factor_high=1.1, gravity_factor_low=0.95, gravity_factor_high=1.05)
    assert result.settled is not None
    (mass, gravity), = asked
    names = list(env.spec.condition_names)
    known = {
        (int(row), int(episode)): (mass, drawn[names.index('gravity_factor')])
        for part in flown for row, episode, mass, drawn in zip(
            part.row, part.episode, part.mass, part.conditions, strict=True)}
    ground = result.episodes.take(result.ground)
    expected = np.array([
        known[key] for key in zip(ground.row.tolist(), ground.episode.tolist(), strict=True)])
    assert len(expected) > 10 and np.ptp(expected[:, 0]) > 2000
    np.testing.assert_array_equal(mass, expected[:, 0])
    np.testing.assert_array_equal(gravity, 9.81 * expected[:, 1])


@pytest.mark.parametrize('settings', [
    {'velocity_scale': 0.1}, {'position_scale': 0.1}, {'observation_limit': 0.9}])
def test_clipped_touchdowns_give_no_standing_rate(settings: dict[str, float]) -> None:
    """Clipped to 0.5 m/s, rockets that crash would stand."""
    env = worlds.make('rocket', num_envs=4, spawn_height=20.0, **settings)
    result = evaluate(env, Falling(), 4, 1, level=1)
    assert result.ground.any()
    assert result.settled is None
    assert metrics.summarise(result)['standing_rate'] is None


def test_a_limit_of_one_does_not_clip_an_upright_rocket() -> None:
    upright = ends((0, 0, 0, 0))
    assert not standing.is_clipped(upright, {**SETTINGS, 'observation_limit': 1.0})
    assert standing.is_clipped(upright, {**SETTINGS, 'observation_limit': 0.99})


def test_random_flights_have_a_standing_rate_of_zero() -> None:
    env = worlds.make('rocket', num_envs=20)
    summary = metrics.summarise(evaluate(env, RandomPilot(env.spec), 20, 1, level=1))
    assert summary['standing_rate'] == 0.0
    json.dumps(summary, allow_nan=False)


def test_a_lander_has_no_standing_rate() -> None:
    """A lander counts as landed only at rest."""
    env = worlds.make('lunar_lander', num_envs=10)
    summary = metrics.summarise(evaluate(env, scripted_pilot(env.spec), 10, 1))
    assert summary['standing_rate'] is None
    assert 'standing' not in metrics.table(summary)
