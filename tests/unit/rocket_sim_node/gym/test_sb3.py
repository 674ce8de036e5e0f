# SPDX-License-Identifier: Apache-2.0
"""The adapter for stable-baselines3, where that is installed."""
from __future__ import annotations

import builtins
import importlib
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest

from rocket_sim_node.gym import IDS
from rocket_sim_node.gym import ReverseCurriculum

N = 3
LOW = {'spawn_reach': 15.0}


def make(**keywords: Any) -> Any:
    pytest.importorskip('stable_baselines3')
    from rocket_sim_node.gym.sb3 import HoverslamVecEnv

    return HoverslamVecEnv(gymnasium.make_vec(
        'hoverslam/Rocket-v1', **{'num_envs': N, 'seed': 1, **LOW, **keywords}))


def fly(env: Any, steps: int = 300) -> list[Any]:
    random = np.random.default_rng(3)
    return [env.step(random.uniform(-1, 1, (N, 3)).astype(np.float32)) for _ in range(steps)]


@pytest.mark.filterwarnings('ignore::UserWarning')
@pytest.mark.parametrize('name', IDS.values())
def test_single_environments_pass_the_check_of_sb3(name: str) -> None:
    pytest.importorskip('stable_baselines3')
    from stable_baselines3.common.env_checker import check_env

    check_env(gymnasium.make(name, render_mode='rgb_array'))


@pytest.mark.filterwarnings('ignore:The environment is already wrapped with a `Monitor`')
def test_infos_of_ended_episodes_agree_with_vec_monitor() -> None:
    ours = make()
    from stable_baselines3.common.vec_env import VecMonitor

    theirs = VecMonitor(make())
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    ended = 0
    for one, other in zip(fly(ours), fly(theirs), strict=True):
        for mine, monitored in zip(one[3], other[3], strict=True):
            assert mine.keys() == monitored.keys()
            if mine:
                ended += 1
                assert mine['episode']['r'] == pytest.approx(monitored['episode']['r'], abs=1e-4)
                assert mine['episode']['l'] == monitored['episode']['l']
                assert mine['terminal_observation'].shape == (15,)
                assert mine['TimeLimit.truncated'] is False
        assert [bool(info) for info in one[3]] == one[2].tolist()
    assert ended > N


def test_vec_normalize_wraps_the_adapter() -> None:
    env = make()
    from stable_baselines3.common.vec_env import VecNormalize

    normalised = VecNormalize(env)
    normalised.reset()
    seen = np.concatenate([step[0] for step in fly(normalised)])
    assert np.isfinite(seen).all()
    assert normalised.obs_rms.count == pytest.approx(301 * N, abs=1)
    normalised.close()


def test_evaluation_reports_true_returns_of_normalised_rewards() -> None:
    env = make()
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecNormalize

    model = PPO('MlpPolicy', env, seed=1, device='cpu')
    env.seed(5)
    true, lengths = evaluate_policy(model, env, 2 * N, return_episode_rewards=True, warn=False)
    env.seed(5)
    normalised = VecNormalize(env, training=False, norm_obs=False)
    normalised.ret_rms.var = np.array(1e4)  # as of a training
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = evaluate_policy(model, normalised, 2 * N, return_episode_rewards=True)
    assert found == (true, lengths)
    assert np.abs(true).max() > 10  # normalised rewards are clipped to 10, and a hundredth


def test_only_a_monitor_is_said_to_wrap_the_environments() -> None:
    env = make()
    from stable_baselines3.common.monitor import Monitor

    assert env.env_is_wrapped(Monitor) == [True] * N
    assert env.env_is_wrapped(Monitor, indices=[1]) == [True]
    assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit) == [False] * N


class AddsTime(gymnasium.vector.VectorWrapper):
    """A wrapper that adds to the info of each step."""

    def step(self, actions: Any) -> Any:
        *found, info = self.env.step(actions)
        return *found, {**info, 'time': np.zeros(N)}


def test_infos_of_wrappers_do_not_look_like_ends() -> None:
    wrapped = make()
    wrapped.env = AddsTime(wrapped.env)
    ours = make()
    np.testing.assert_array_equal(ours.reset(), wrapped.reset())
    for one, other in zip(fly(ours), fly(wrapped), strict=True):
        assert [set(info) for info in one[3]] == [set(info) for info in other[3]]


def test_recorders_of_videos_find_the_frame_rate() -> None:
    env = make(render_mode='rgb_array')
    assert env.metadata['render_fps'] == 50
    assert env.metadata['render_modes'] == ['human', 'rgb_array']
    env.reset()
    assert env.render().shape[2] == 3


def test_seed_and_options_reach_the_next_reset() -> None:
    env = make(seed=None)
    env.seed(5)
    first = env.reset()
    other = env.reset()
    env.seed(5)
    np.testing.assert_array_equal(env.reset(), first)
    assert (other != first).any()
    env.seed(5)
    env.set_options({'level': 1})
    assert (env.reset() != first).any()


def test_refused_options_are_used_up() -> None:
    env = make()
    env.set_options({'none': 3})
    with pytest.raises(ValueError, match="unknown setting 'none'"):
        env.reset()
    env.reset()


def test_what_environments_share_cannot_be_set_for_some_of_them() -> None:
    env = make(num_envs=4, spawn_reach=0.0)
    env.env = ReverseCurriculum(env.env)
    assert {spec.name for spec in env.get_attr('world_spec')} == {'rocket'}
    for misuse in (lambda: env.env_method('close', indices=[1]),
                   lambda: env.set_attr('render_mode', None, indices=[0])):
        with pytest.raises(ValueError, match=r'indices: got .*expected None'):
            misuse()
    env.set_options([{'level': 1}, {'level': 2}, {'level': 1}, {'level': 1}])
    with pytest.raises(ValueError, match='set_options: got'):
        env.reset()
    env.set_options({'level': 3})
    env.reset()
    env.close()


def test_only_same_step_autoreset_is_accepted() -> None:
    with pytest.raises(ValueError, match='autoreset_mode SAME_STEP'):
        make(autoreset_mode='NEXT_STEP')


def test_a_missing_library_is_named_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith('stable_baselines3'):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
        return real(name, *rest)

    monkeypatch.delitem(sys.modules, 'rocket_sim_node.gym.sb3', raising=False)
    monkeypatch.setattr(builtins, '__import__', without)
    with pytest.raises(ImportError, match='pip install stable-baselines3'):
        importlib.import_module('rocket_sim_node.gym.sb3')
