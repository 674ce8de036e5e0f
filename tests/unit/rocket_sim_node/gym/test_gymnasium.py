# SPDX-License-Identifier: Apache-2.0
"""The worlds as Gymnasium environments: its checks, its forms, and the flights of our worlds."""
from __future__ import annotations

import re
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from rocket_sim_node import worlds
from rocket_sim_node.gym import IDS

N, STEPS = 3, 400
LOW = {'spawn_reach': 15.0}
"""Starts so low that many episodes end within the steps of a test."""


def make(name: str = 'hoverslam/Rocket-v1', **keywords: Any) -> Any:
    return gymnasium.make_vec(name, **{'num_envs': N, 'seed': 1, **LOW, **keywords})


def fly(envs: Any, steps: int = STEPS) -> list[Any]:
    """Return what steps with random actions return."""
    envs.action_space.seed(3)
    return [envs.step(envs.action_space.sample()) for _ in range(steps)]


def assert_equal(ours: Any, theirs: Any) -> None:
    """Compare two infos, as deep as they go."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for name, value in ours.items():
            assert_equal(value, theirs[name])
    elif ours.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, other)
    else:
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.filterwarnings('ignore:.*Box observation space')
@pytest.mark.parametrize('name', IDS.values())
def test_single_environments_pass_gymnasiums_check(name: str) -> None:
    check_env(gymnasium.make(name, render_mode='rgb_array').unwrapped)


@pytest.mark.parametrize('keywords', [
    {}, {'observation': 'extended', 'conditions': 'harsh'}, {'observation_limit': 0.5}])
def test_observations_stay_within_their_space(keywords: dict[str, Any]) -> None:
    envs = make(**keywords)
    first, info = envs.reset()
    assert info == {}
    assert envs.observation_space.contains(first)
    assert all(envs.observation_space.contains(step[0]) for step in fly(envs))
    limit = keywords.get('observation_limit', 5.0)
    assert envs.single_observation_space.high[:15].tolist() == [limit] * 15


def test_commands_of_the_past_are_bounded_as_actions_are() -> None:
    high = make(observation='extended').single_observation_space.high
    assert high.tolist() == [5.0] * 15 + [1.0] * 15 + [5.0] * 6


@pytest.mark.parametrize(('world', 'name'), IDS.items())
def test_flights_are_those_of_the_world(world: str, name: str) -> None:
    settings = {} if world == 'lunar_lander' else LOW
    envs = gymnasium.make_vec(name, num_envs=N, **settings)
    ours = worlds.make(world, N, 7, **settings)
    np.testing.assert_array_equal(envs.reset(seed=7)[0], ours.reset(7))
    envs.action_space.seed(3)
    ended = 0
    for _ in range(STEPS):
        action = envs.action_space.sample()
        *got, info = envs.step(action)
        *expected, world_info = ours.step(action)
        for one, other in zip(got, expected, strict=True):
            np.testing.assert_array_equal(one, other)
        rows = world_info['final_rows']
        assert bool(info) == bool(len(rows))
        for row, last in zip(rows.tolist(), world_info['final_observation'], strict=True):
            np.testing.assert_array_equal(info['final_obs'][row], last)
            figures, ended = info['final_info'], ended + 1
            episode = world_info['episodes'].take(world_info['episodes'].row == row)
            assert figures['episode_return'][row] == episode.episode_return[0]
            assert figures['tilt'][row] == episode.tilt[0]
    assert ended


@pytest.mark.parametrize('mode', [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_infos_have_the_form_of_gymnasiums_own(mode: AutoresetMode) -> None:
    """One rocket as ours, and as Gymnasium makes a vector environment of single ones."""
    ours = make(num_envs=1, autoreset_mode=mode)
    theirs = SyncVectorEnv(
        [lambda: gymnasium.make('hoverslam/Rocket-v1', seed=1, **LOW)], autoreset_mode=mode)
    theirs.reset(seed=1)
    ours.reset(seed=1)
    found = False
    for one, other in zip(fly(ours), fly(theirs), strict=True):
        if found and mode is AutoresetMode.NEXT_STEP:
            return  # the next episode begins one step late in ours
        assert_equal(one[4], other[4])
        found |= bool(one[4])
        for index in range(4):
            np.testing.assert_array_equal(one[index], other[index])
    assert found


def test_next_step_returns_the_last_observation_and_then_begins() -> None:
    envs, world = make(autoreset_mode='NEXT_STEP'), worlds.make('rocket', N, 1, **LOW)
    counted = RecordEpisodeStatistics(envs)
    counted.reset(seed=1)
    world.reset(1)
    envs.action_space.seed(3)
    ended = np.zeros(N, np.bool_)
    found = 0
    for _ in range(STEPS):
        action = envs.action_space.sample()
        observation, reward, terminated, truncated, info = counted.step(action)
        action[ended] = world.spec.action_idle
        _, _, _, _, world_info = expected = world.step(action)
        assert (reward[ended] == 0).all() and not (terminated | truncated)[ended].any()
        np.testing.assert_array_equal(observation[ended], expected[0][ended])
        ended = terminated | truncated
        if ended.any():
            rows = np.flatnonzero(ended)
            found += len(rows)
            last = world_info['final_observation'][np.isin(world_info['final_rows'], rows)]
            np.testing.assert_array_equal(observation[rows], last)
            np.testing.assert_allclose(
                info['episode_return'][rows], info['episode']['r'][rows], rtol=1e-5)
            np.testing.assert_array_equal(
                info['episode_length'][rows], info['episode']['l'][rows])
            assert info['_tilt'].tolist() == ended.tolist()
    assert found > N


def test_same_step_counts_as_gymnasiums_wrapper_does() -> None:
    envs = RecordEpisodeStatistics(make())
    envs.reset(seed=1)
    ends = [step[4] for step in fly(envs) if step[4]]
    assert ends
    for info in ends:
        np.testing.assert_allclose(
            info['final_info']['episode_return'], info['episode']['r'], rtol=1e-5)
        np.testing.assert_array_equal(info['final_info']['episode_length'], info['episode']['l'])


def test_seeds() -> None:
    first = make().reset()[0]
    np.testing.assert_array_equal(first, make().reset()[0])
    np.testing.assert_array_equal(first, make(seed=None).reset(seed=1)[0])
    assert (first != make(seed=None).reset()[0]).any()
    envs = make()
    envs.reset()
    assert (first != envs.reset()[0]).any()
    np.testing.assert_array_equal(first, envs.reset(seed=1)[0])


def drawn(env: Any, seed: int = 3) -> Any:
    """Return the first observation after the user has set the generator."""
    env.unwrapped.np_random = np.random.default_rng(seed)
    return env.reset()[0]


def test_a_generator_that_the_user_sets_gives_the_next_seed() -> None:
    for env in gymnasium.make('hoverslam/Rocket-v1', seed=1), make():
        first = drawn(env)  # before the first reset
        generator = env.unwrapped.np_random
        assert (env.reset()[0] != first).any()  # once: the next episode
        assert env.unwrapped.np_random is generator
        np.testing.assert_array_equal(drawn(env), first)
        assert (drawn(env, 4) != first).any()
        env.unwrapped.np_random = np.random.default_rng(3)
        seeded = env.reset(seed=1)[0]
        assert (seeded != first).any()
        np.testing.assert_array_equal(drawn(env), first)
        np.testing.assert_array_equal(env.reset(seed=1)[0], seeded)


def test_a_generator_that_the_user_sets_counts_after_the_end_of_an_episode() -> None:
    env = gymnasium.make('hoverslam/Rocket-v1', seed=1, **LOW)
    first = drawn(env)
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    np.testing.assert_array_equal(drawn(env), first)
    np.testing.assert_array_equal(drawn(make(num_envs=1))[0], first)


def test_the_seed_of_make_is_that_of_the_generator() -> None:
    for env in gymnasium.make('hoverslam/Rocket-v1', seed=4), make(seed=4):
        first = env.reset()[0]
        assert env.unwrapped.np_random_seed == 4
        env.reset()
        assert env.unwrapped.np_random_seed == 4
        env.reset(seed=5)
        assert env.unwrapped.np_random_seed == 5
        np.testing.assert_array_equal(env.reset(seed=4)[0], first)


def test_options_last_until_the_next_reset() -> None:
    envs = gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=N, level=7)
    seventh = envs.reset(seed=1)[0]
    first = envs.reset(seed=1, options={'level': 1, 'conditions': 'mix'})[0]
    assert (first != seventh).any()
    np.testing.assert_array_equal(envs.reset(seed=1)[0], seventh)


def test_a_single_environment_flies_the_episodes_of_the_first_row() -> None:
    env, envs = gymnasium.make('hoverslam/Rocket-v1', seed=1, **LOW), make(num_envs=1)
    observation, _ = env.reset(seed=1)
    envs.reset(seed=1)
    envs.action_space.seed(3)
    for _ in range(STEPS):
        action = envs.action_space.sample()
        seen, *_ = envs.step(action)
        observation, _, terminated, truncated, info = env.step(action[0])
        if terminated or truncated:
            assert info['episode_length'] > 0 and isinstance(info['is_success'], bool)
            with pytest.raises(gymnasium.error.ResetNeeded):
                env.unwrapped.step(action[0])
            observation, _ = env.reset()
        np.testing.assert_array_equal(observation, seen[0])


def test_a_refused_reset_of_a_single_environment_does_not_begin_the_next_episode() -> None:
    env = gymnasium.make('hoverslam/Rocket-v1', seed=1, **LOW).unwrapped
    env.reset(seed=1)
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    with pytest.raises(ValueError, match='leevl'):
        env.reset(options={'leevl': 3})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(env.action_space.sample())


def test_true_is_no_number_even_if_the_episode_has_begun_with_1() -> None:
    env = gymnasium.make('hoverslam/Rocket-v1', seed=1, **LOW).unwrapped
    env.reset(options={'level': 1})
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    with pytest.raises(TypeError, match='level: got True, expected a number'):
        env.reset(options={'level': True})
    env.reset(options={'level': 1.0})


def test_pictures_show_the_end_of_an_episode() -> None:
    env = gymnasium.make('hoverslam/Rocket-v1', render_mode='rgb_array', seed=1, **LOW)
    env.reset()
    first = env.render()
    first[:] = first  # may be written to
    assert first.shape == (500, 400, 3) and first.dtype == np.uint8
    done, last = False, first
    while not done:
        before = last
        _, _, terminated, truncated, _ = env.step(np.array([-1.0, 0.0, 0.0], np.float32))
        done, last = terminated or truncated, env.render()
    # The next episode has begun in the world: its start would look quite different.
    assert np.abs(last.astype(int) - before).mean() < np.abs(last.astype(int) - first).mean()


@pytest.mark.parametrize('mode', ['SAME_STEP', 'NEXT_STEP'])
@pytest.mark.parametrize('name', IDS.values())
def test_a_snapshot_continues_with_the_same_flights(name: str, mode: str) -> None:
    low = {} if 'Lander' in name else LOW
    envs = gymnasium.make_vec(name, num_envs=N, autoreset_mode=mode, **low)
    envs.reset(seed=7)
    ended = False
    while not ended:  # so that NEXT_STEP has a state of its own
        _, _, terminated, truncated, _ = envs.step(envs.action_space.sample())
        ended = bool((terminated | truncated).any())
    state = envs.snapshot()
    expected = fly(envs)
    copy = gymnasium.make_vec(name, num_envs=N, autoreset_mode=mode, **low)
    copy.restore(state)
    for one, other in zip(fly(copy), expected, strict=True):
        for index in range(4):
            np.testing.assert_array_equal(one[index], other[index])
        assert_equal(one[4], other[4])


@pytest.mark.parametrize('at_end', [False, True])
def test_a_snapshot_of_a_single_environment(at_end: bool) -> None:
    env, copy = (
        gymnasium.make('hoverslam/Rocket-v1', seed=seed, render_mode='rgb_array', **LOW).unwrapped
        for seed in (1, 2))
    env.reset(options={'level': 3})
    idle = np.array([-1.0, 0.0, 0.0], np.float32)
    ended = any(env.step(idle)[2:4])
    while at_end and not ended:
        ended = any(env.step(idle)[2:4])
    state = env.snapshot()
    copy.restore(state)
    for one in env, copy:
        if at_end:
            with pytest.raises(gymnasium.error.ResetNeeded):
                one.step(idle)
        else:
            while not any(one.step(idle)[2:4]):
                pass
    assert copy.render().shape == (500, 400, 3)
    starts = [one.reset(options={'level': np.float64(3)})[0] for one in (env, copy)]
    np.testing.assert_array_equal(*starts)
    np.testing.assert_array_equal(env.step(idle)[0], copy.step(idle)[0])


@pytest.mark.parametrize('make_one', [gymnasium.make, gymnasium.make_vec])
@pytest.mark.parametrize('name', IDS.values())
def test_an_environment_is_copied_or_says_what_to_use_instead(name: str, make_one: Any) -> None:
    """The original continues with the same bits either way."""
    low = {} if 'Lander' in name else LOW
    env, same = (make_one(name, **low) for _ in range(2))
    for one in env, same:
        one.reset(seed=7)
        one.action_space.seed(3)
    for _ in range(30):
        action = env.action_space.sample()
        env.step(action)
        same.step(action)
    followers = [same]
    if name == IDS['rocket']:
        followers.append(deepcopy(env))
    else:
        with pytest.raises(TypeError, match=(
                r'^deepcopy: an environment of \w+ cannot be copied; restore its snapshot in ')):
            deepcopy(env)
    for _ in range(200):
        action = env.action_space.sample()
        one = env.step(action)
        for follower in followers:
            for ours, theirs in zip(follower.step(action)[:4], one[:4], strict=True):
                np.testing.assert_array_equal(ours, theirs)
        if make_one is gymnasium.make and any(one[2:4]):
            for other in env, *followers:
                other.reset()


def test_snapshots_of_another_kind_are_refused() -> None:
    envs = make()
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.snapshot()
    envs.reset()
    state = envs.snapshot()
    with pytest.raises(ValueError, match='snapshot: ended is bool of shape'):
        make(num_envs=N + 1).restore(state)
    with pytest.raises(ValueError, match="snapshot: of world 'rocket', expected 'rocket_planar'"):
        make('hoverslam/RocketPlanar-v1').restore(state)
    with pytest.raises(ValueError, match='snapshot: not readable'):
        envs.restore(state[:100])
    with pytest.raises(ValueError, match='snapshot: got None, expected bytes'):
        envs.restore(None)
    with pytest.raises(ValueError, match='snapshot: of the other autoreset mode'):
        make(autoreset_mode='NEXT_STEP').restore(state)
    single = gymnasium.make('hoverslam/Rocket-v1').unwrapped
    with pytest.raises(ValueError, match='snapshot: holds'):
        single.restore(state)


def test_closing_is_final_and_may_be_repeated() -> None:
    envs = make()
    envs.reset()
    envs.close()
    envs.close()
    with pytest.raises(gymnasium.error.ClosedEnvironmentError):
        envs.step(np.zeros((N, 3), np.float32))


def test_a_closed_environment_begins_no_episode_even_if_one_is_ready() -> None:
    env = gymnasium.make('hoverslam/Rocket-v1', seed=1, **LOW).unwrapped
    env.reset()
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    env.close()
    for use in env.reset, env.snapshot, env.render, lambda: env.step(np.zeros(3)):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError):
            use()


def test_without_a_reset_there_is_no_step_and_no_snapshot() -> None:
    envs = make()
    with pytest.raises(gymnasium.error.ResetNeeded, match='step: call reset first'):
        envs.unwrapped.step(np.zeros((N, 3)))
    with pytest.raises(gymnasium.error.ResetNeeded, match='snapshot: call reset first'):
        envs.unwrapped.snapshot()


@pytest.mark.parametrize('mode', ['SAME_STEP', 'NEXT_STEP'])
def test_ragged_actions_are_named(mode: str) -> None:
    envs = make(autoreset_mode=mode)
    envs.reset()
    message = 'action: got [[1, 2, 3], [1], [2]], whose parts differ in length, expected shape (3'
    with pytest.raises(ValueError, match=re.escape(message)):
        envs.step([[1, 2, 3], [1], [2]])


@pytest.mark.parametrize(('world', 'action', 'message'), [
    ('Rocket', [[1, 2, 3]], 'got int64 of shape (1, 3), expected numbers of shape (3,)'),
    ('Rocket', 'abc', 'got <U3 of shape (), expected numbers of shape (3,)'),
    ('Rocket', [1, [2, 3]], 'got [1, [2, 3]], whose parts differ in length, expected shape (3,)'),
    ('LunarLander', [2], 'got int64 of shape (1,), expected whole numbers of shape ()'),
    ('LunarLander', 2.0, 'got float64 of shape (), expected whole numbers of shape ()'),
])
def test_bad_actions_are_named_by_the_shape_of_one(
    world: str, action: Any, message: str,
) -> None:
    env = gymnasium.make(f'hoverslam/{world}-v1').unwrapped
    env.reset()
    with pytest.raises(ValueError, match=re.escape(f'action: {message}')):
        env.step(action)


@pytest.mark.parametrize(('keywords', 'message'), [
    ({'levle': 7}, "unknown keyword 'levle' (did you mean 'level'?), expected num_envs, seed,"),
    ({'autoreset_mode': np.array(['a', 'b'])}, "autoreset_mode: got array(['a', 'b']"),
    ({'render_mode': np.array(['a', 'b'])}, "render_mode: got array(['a', 'b']"),
    ({'conditions': np.array(['a', 'b'])}, "conditions: got array(['a', 'b']"),
    ({'autoreset_mode': 'DISABLED'}, "got 'DISABLED', expected SAME_STEP or NEXT_STEP"),
    ({'render_mode': 'human'}, "render_mode: got 'human', expected None or 'rgb_array'"),
    ({'simulators': '/sim', 'render_mode': 'rgb_array'}, 'watch them with the node'),
    ({'level': 9}, 'level: got 9, expected 1 to 8'),
    ({'num_envs': 0}, 'num_envs: got 0'),
    ({'num_envs': True}, 'num_envs: got True'),
    ({'seed': True}, 'seed: got True, expected a whole number from 0'),
    ({'patience': -3}, 'patience: got -3, expected a finite number above 0, s'),
    ({'simulators': '/sim_*', 'num_envs': 0}, 'num_envs: got 0'),  # without waiting for any
    ({'simulators': '/sim_*', 'seed': -1}, 'seed: got -1'),
])
def test_bad_keywords_are_named(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make(**keywords)


@pytest.mark.parametrize(('keywords', 'message'), [
    ({'simulators': 3}, "simulators: got 3, expected a string, such as '/sim_*'"),
    ({'patience': 'a'}, "patience: got 'a', expected a number of seconds"),
    ({'level': np.array([1, 2])}, 'level: got array([1, 2]), expected a number'),
    ({'step_threads': np.array([1, 2])}, 'step_threads: got array([1, 2]), expected a number'),
])
def test_keywords_of_a_wrong_type_are_named(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=re.escape(message)):
        make(**keywords)


@pytest.mark.parametrize('name', ['autoreset_mode', 'num_envs', 'step_threads'])
def test_keywords_of_vector_environments_are_refused_by_single_ones(name: str) -> None:
    message = f'{name}: got 4, expected no such keyword of gymnasium.make, which makes one'
    with pytest.raises(ValueError, match=message):
        gymnasium.make('hoverslam/Rocket-v1', **{name: 4})
    with pytest.raises(ValueError, match=r"'zzz', expected seed, render_mode"):
        gymnasium.make('hoverslam/Rocket-v1', zzz=4)


def test_integers_of_numpy_are_numbers() -> None:
    first = make(num_envs=np.int64(N), seed=np.uint8(1), level=np.int32(3)).reset()[0]
    np.testing.assert_array_equal(first, make(level=3).reset(seed=np.int64(1))[0])


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'options': {'level': 10**400}}, 'level: got 1000000'),
    ({'options': {'levle': 7}}, "unknown setting 'levle', expected level"),
    ({'options': {'reset_mask': np.ones(N, bool)}}, "got 'reset_mask', expected none"),
    ({'seed': [1, 2, 3]}, 'seed: got [1, 2, 3], expected a whole number from 0 to'),
    ({'options': {'seed': 5}}, "options: got 'seed', expected it as an argument of reset"),
])
def test_bad_resets_are_named(arguments: dict[str, Any], message: str) -> None:
    for env in make(), gymnasium.make('hoverslam/Rocket-v1').unwrapped:
        with pytest.raises(ValueError, match=re.escape(message)):
            env.reset(**arguments)


@pytest.mark.parametrize(('options', 'message'), [
    (5, "options: got 5, expected a dictionary, such as {'level': 3}"),
    ({3: 5}, 'options: got {3: 5}, expected a dictionary'),
])
def test_options_of_a_wrong_type_are_named(options: Any, message: str) -> None:
    for env in make(), gymnasium.make('hoverslam/Rocket-v1').unwrapped:
        with pytest.raises(TypeError, match=re.escape(message)):
            env.reset(options=options)


def test_the_entry_point_registers() -> None:
    from importlib.metadata import EntryPoint

    setup = (__file__.partition('/tests/')[0]) + '/rocket_sim_node/setup.py'
    with open(setup) as file:
        value = re.search(r"'gymnasium.envs': \['hoverslam = ([\w.:]+)'\]", file.read())[1]
    EntryPoint('hoverslam', value, 'gymnasium.envs').load()()
    assert set(IDS.values()) <= set(gymnasium.registry)


def test_videos_are_recorded(tmp_path: Path) -> None:
    pytest.importorskip('moviepy')
    env = gymnasium.wrappers.RecordVideo(
        gymnasium.make('hoverslam/Rocket-v1', render_mode='rgb_array', seed=1, **LOW),
        str(tmp_path), disable_logger=True)
    env.reset()
    while not any(env.step(np.array([-1.0, 0.0, 0.0], np.float32))[2:4]):
        pass
    env.close()
    video, = tmp_path.glob('*.mp4')
    assert video.stat().st_size > 1000
