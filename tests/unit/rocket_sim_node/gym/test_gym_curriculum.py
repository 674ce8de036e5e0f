# SPDX-License-Identifier: Apache-2.0
"""The reverse curriculum as a wrapper."""
from __future__ import annotations

import re
from typing import Any

import gymnasium
import numpy as np
import pytest

from rocket_sim_node.gym import ReverseCurriculum
from rocket_sim_node.worlds import start_heights
from rocket_sim_node.worlds.lunar import vehicle
from rocket_sim_node.worlds.lunar import view
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld

N = 8
IDLE = np.tile(np.float32([-1, 0, 0]), (N, 1))
"""engine off: from less than a metre, that is a landing"""


def make(**keywords: Any) -> ReverseCurriculum:
    envs = gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=N, seed=1)
    return ReverseCurriculum(envs, **{'window': N, 'landing_rate': 0.9, **keywords})


def heights(envs: ReverseCurriculum) -> Any:
    """Return heights above touchdown."""
    settings = envs.unwrapped.world_spec.settings
    return envs.unwrapped.simulated.position[1] - settings['touchdown_height']


def test_the_reach_grows_with_landings_and_truncates_other_episodes() -> None:
    envs = make()
    envs.reset()
    assert heights(envs).max() <= 0.4
    cut = 0
    for _ in range(100):
        before = envs.reach
        observation, reward, terminated, truncated, info = envs.step(IDLE)
        assert observation.shape == (N, 15) and reward.shape == (N,)
        done = terminated | truncated
        if envs.reach != before:
            assert envs.reach == pytest.approx(1.25 * before)
            assert done.all()
            assert (heights(envs) <= envs.reach).all()
            cut += int(truncated.sum())
        else:
            assert not truncated.any()
        if info:
            np.testing.assert_array_equal(info['_final_obs'], done)
            np.testing.assert_array_equal(info['_final_info'], terminated)
            assert all(info['final_obs'][row].shape == (15,) for row in np.flatnonzero(done))
    assert envs.reach > 0.45
    assert cut > 0


class AddsTime(gymnasium.vector.VectorWrapper):
    """A wrapper that adds to the info of each step."""

    def step(self, actions: Any) -> Any:
        *found, info = self.env.step(actions)
        return *found, {**info, 'time': np.zeros(N)}


def test_infos_of_wrappers_do_not_look_like_ends() -> None:
    ours, wrapped = make(), ReverseCurriculum(
        AddsTime(gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=N, seed=1)),
        window=N, landing_rate=0.9)
    for envs in ours, wrapped:
        envs.reset()
        for _ in range(100):
            envs.step(IDLE)
    assert wrapped.reach == ours.reach > 0.4


def test_the_lander_begins_near_the_ground() -> None:
    envs = ReverseCurriculum(
        gymnasium.make_vec('hoverslam/LunarLander-v1', num_envs=N, seed=1), reach=1.0, window=N,
        landing_rate=0.0)
    observation, _ = envs.reset()
    assert (observation[:, 1] < 0.2).all()
    while envs.reach == 1.0:
        observation, *_ = envs.step(np.zeros(N, np.int64))
    assert envs.reach == 1.25
    simulated = envs.unwrapped.simulated
    assert isinstance(simulated, LunarLanderWorld)
    height = 1.25 * start_heights.reach_share(1, simulated.rows, simulated.episode)
    # The push moves a lander by less than this before its first observation.
    moved = vehicle.START_PUSH * 0.02**2 / vehicle.TOTAL_MASS
    assert view.seen_height(observation) == pytest.approx(height, abs=moved)


def test_equal_seeds_give_equal_flights() -> None:
    one, other = make(), make()
    np.testing.assert_array_equal(one.reset(seed=3)[0], other.reset(seed=3)[0])
    for _ in range(60):
        mine, theirs = one.step(IDLE), other.step(IDLE)
        for left, right in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(left, right)
    assert one.reach == other.reach > 0.4


def test_after_the_full_reach_the_starts_are_the_ordinary_ones() -> None:
    envs = make(reach=194.8, landing_rate=0.0, window=1)
    envs.reset(seed=1)
    while not envs.over:
        envs.step(IDLE)
    np.testing.assert_allclose(heights(envs), 194.8)
    assert envs.reach == 194.8
    envs.reset(seed=2)
    np.testing.assert_allclose(heights(envs), 194.8)


def fly_to_the_end(envs: ReverseCurriculum) -> list[float]:
    """Return the reaches until the curriculum is over."""
    reaches = [envs.reach]
    while not envs.over:
        envs.step(IDLE)
        if envs.reach != reaches[-1]:
            reaches.append(envs.reach)
    return reaches


@pytest.mark.parametrize(('height', 'reaches'), [
    (20.0, [10.0, 14.8]), (240.0, [10.0, 210.0, 234.8])])
def test_the_full_reach_is_that_of_the_last_reset(height: float, reaches: list[float]) -> None:
    envs = make(reach=10.0, growth=21.0, landing_rate=0.0, window=1)
    envs.reset(seed=1, options={'spawn_height': height})
    assert fly_to_the_end(envs) == pytest.approx(reaches)
    np.testing.assert_allclose(heights(envs), reaches[-1])


def test_a_reset_to_a_smaller_drop_limits_the_reach() -> None:
    envs = make(reach=30.0)
    with pytest.raises(ValueError, match="'spawn_height': got 1"):
        envs.reset(seed=1, options={'spawn_height': 1.0})
    assert envs.reach == 30.0
    envs.reset(seed=1, options={'spawn_height': np.float32(20.0)})
    assert envs.reach == pytest.approx(14.8)
    with pytest.raises(TypeError, match="spawn_height: got '20', expected a number"):
        envs.reset(seed=1, options={'spawn_height': '20'})


def test_stable_baselines3_gets_the_truncated_episodes() -> None:
    pytest.importorskip('stable_baselines3')
    from rocket_sim_node.gym.sb3 import HoverslamVecEnv

    env = HoverslamVecEnv(make())
    env.reset()
    cut = []
    while not cut:
        _, _, done, infos = env.step(IDLE)
        cut = [info for info in infos if info.get('TimeLimit.truncated')]
    assert done.all()
    assert all(set(info) == {'terminal_observation', 'TimeLimit.truncated'} for info in cut)
    assert any('episode' in info for info in infos)


@pytest.mark.parametrize(('name', 'keywords', 'message'), [
    ('LunarLander', {'reach': 9.5}, 'reach: got 9.5, expected more than 0, to 9.43'),
    ('Rocket', {'reach': 0.0}, 'reach: got 0.0, expected more than 0, to 194.8 m'),
    ('Rocket', {'reach': 300.0}, 'reach: got 300.0'),
    ('Rocket', {'growth': 1.0}, 'growth: got 1.0, expected more than 1'),
    ('Rocket', {'landing_rate': 1.5}, 'landing_rate: got 1.5, expected 0 to 1'),
    ('Rocket', {'window': 0}, 'window: got 0, expected a whole number from 1'),
    ('Rocket', {'window': 1.5}, 'window: got 1.5, expected a whole number'),
    ('Rocket', {'window': True}, 'window: got True, expected a whole number'),
    ('Rocket', {'reach': 'a'}, "reach: got 'a', expected a number"),
    ('Rocket', {'growth': None}, 'growth: got None, expected a number'),
])
def test_bad_arguments_are_named(name: str, keywords: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=re.escape(message)):
        ReverseCurriculum(gymnasium.make_vec(f'hoverslam/{name}-v1', num_envs=2), **keywords)


def test_a_reach_beside_that_of_the_curriculum_is_refused() -> None:
    message = 'spawn_reach: got 5.0, expected none: the curriculum sets it'
    with pytest.raises(ValueError, match=message):
        ReverseCurriculum(gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=2, spawn_reach=5.0))
    envs = make()
    with pytest.raises(ValueError, match=message):
        envs.reset(options={'spawn_reach': 5.0})


@pytest.mark.parametrize(('options', 'message'), [
    (3, "options: got 3, expected a dictionary, such as {'level': 3}"),
    ({'spawn_height': 10**400}, 'spawn_height: got 1000000'),
    ({'spawn_reach': np.array([1, 2])}, 'spawn_reach: got array([1, 2]), expected none'),
])
def test_bad_resets_are_named(options: Any, message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=re.escape(message)):
        make().reset(options=options)


def test_a_world_without_start_heights_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('rocket_sim_node.worlds.reset_settings', lambda name: ())
    with pytest.raises(ValueError, match='expected one with setting spawn_reach'):
        make()


def test_another_autoreset_mode_is_refused() -> None:
    with pytest.raises(ValueError, match='expected a HoverslamVectorEnv with autoreset_mode'):
        ReverseCurriculum(gymnasium.make_vec(
            'hoverslam/Rocket-v1', num_envs=2, autoreset_mode='NEXT_STEP'))
