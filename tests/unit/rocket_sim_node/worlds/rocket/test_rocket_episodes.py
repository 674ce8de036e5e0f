# SPDX-License-Identifier: Apache-2.0
"""Episodes of world `rocket`: observations, ends, rewards, and how the next one begins."""
from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket.world import RocketWorld

F64 = NDArray[np.float64]

IDLE = np.array([[-1.0, 0.0, 0.0]])
OBSERVATION = (
    'position_x', 'position_y', 'position_z', 'velocity_x', 'velocity_y', 'velocity_z',
    'up_x', 'up_y', 'up_z', 'spin_x', 'spin_y', 'spin_z', 'pad_x', 'pad_y', 'pad_z',
)


def placed(
    position: tuple[float, float, float] = (0.0, 200.0, 0.0),
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tilt: float = 0.0,
    **settings: Any,
) -> RocketWorld:
    """Return one rocket in space without air and weight, where an idle step adds v dt, no more."""
    world = worlds.make('rocket', 1, level=1, gravity=0.0, air_density=0.0, **settings)
    world.position[:, 0] = position
    world.velocity[:, 0] = velocity
    world.spin[:] = 0
    world.attitude[:, 0] = Rotation.from_euler('z', tilt, degrees=True).as_quat()
    return world


def end(world: RocketWorld) -> tuple[str, float, dict[str, Any]]:
    """Idle for one step, in which the episode must end; return outcome, reward and info."""
    observation, reward, terminated, truncated, info = world.step(IDLE)
    assert observation.shape == (1, 15)
    assert terminated.tolist() == [True]
    assert truncated.tolist() == [False]
    return world.spec.outcomes[info['episodes'].outcome[0]], float(reward[0]), info


def random_actions(steps: int, num_envs: int, seed: int = 0) -> F64:
    """Return actions `(steps, N, 3)` that fly into every kind of end."""
    actions: F64 = np.random.default_rng(seed).uniform(-1, 1, (steps, num_envs, 3))
    return actions * [1.0, 0.3, 0.3]


def everything(world: RocketWorld, actions: F64) -> list[NDArray[Any]]:
    """Fly and return all results of the steps, stacked over time."""
    results: list[list[NDArray[Any]]] = []
    for action in actions:
        observation, reward, terminated, truncated, info = world.step(action)
        last = np.zeros_like(observation)
        last[info['final_rows']] = info['final_observation']
        ends = np.zeros((len(observation), len(dataclasses.fields(info['episodes']))))
        for column, field in enumerate(dataclasses.fields(info['episodes'])):
            ends[info['final_rows'], column] = getattr(info['episodes'], field.name)
        results.append([observation, reward, terminated, truncated, last, ends])
    return [np.stack(part) for part in zip(*results, strict=True)]


def test_observation_is_laid_out_as_specified() -> None:
    """Fifteen numbers, each by hand."""
    world = placed((10.0, 100.0, -20.0), (4.0, -30.0, 6.0), tilt=30.0)
    world.spin[:, 0] = [0.5, -1.0, 2.0]
    observed = world.observe()
    assert world.spec.observation_names == OBSERVATION
    assert observed.dtype == np.float32
    assert observed.flags.c_contiguous
    assert observed[0] == pytest.approx([
        0.2, 2.0, -0.4, 0.2, -1.5, 0.3, -0.5, np.sqrt(0.75), 0.0, 0.05, -0.1, 0.2,
        -0.2, (5.2 - 100) / 50, 0.4,
    ], abs=1e-7)


def test_observation_is_clipped_to_five() -> None:
    """Every number, at both ends; the up vector cannot reach it."""
    world = placed((1000.0, 1000.0, -1000.0), (500.0, -500.0, 500.0))
    world.spin[:, 0] = [-100, 100, -100]
    assert world.observe()[0].tolist() == [5, 5, -5, 5, -5, 5, 0, 1, 0, -5, 5, -5, -5, -5, 5]
    world.position[:, 0] = [250.0, 250.0, -249.0]
    assert world.observe()[0, :3].tolist() == [5, 5, np.float32(-4.98)]


@pytest.mark.parametrize(('outcome', 'x', 'speed', 'tilt'), [
    ('landed', 0.0, 0.0, 0.0), ('landed', 14.99, 2.99, 9.99), ('too_fast', 0.0, 3.01, 0.0),
    ('tipped', 0.0, 2.99, 10.01), ('off_pad', 15.01, 2.99, 9.99),
    ('too_fast', 16.0, 3.01, 11.0), ('tipped', 16.0, 2.99, 11.0),
])
def test_touchdown_outcomes_and_rewards(
    outcome: str, x: float, speed: float, tilt: float,
) -> None:
    """Each end by construction, paid as worked out by hand, to float32."""
    world = placed((x, 5.0, 0.0), (0.0, -speed, 0.0), tilt)
    named, reward, info = end(world)
    assert named == outcome
    terminal = 100 + (1 - speed / 3) * 100 + (1 - tilt / 10) * 50 + (1 - x / 15) * 50
    expected = -0.01 + (terminal if outcome == 'landed' else -100)
    assert reward == pytest.approx(expected, abs=1e-4)
    episodes = info['episodes']
    assert episodes.episode_return == pytest.approx([expected], abs=1e-9)
    assert episodes.touchdown_speed == pytest.approx([speed], abs=1e-12)
    assert np.rad2deg(episodes.tilt) == pytest.approx([tilt], abs=1e-12)
    assert episodes.distance == pytest.approx([x], abs=1e-12)
    assert (episodes.length[0], episodes.fuel_used[0]) == (1, 0)


def test_speed_and_distance_count_both_horizontal_axes() -> None:
    """Speed is that of all three axes, distance that of x and z."""
    _, reward, info = end(placed((3.0, 5.0, -4.0), (0.3, -0.6, 0.6)))
    episodes = info['episodes']
    assert episodes.touchdown_speed == pytest.approx([0.9], abs=1e-12)
    assert episodes.distance == pytest.approx([np.hypot(3.006, 3.988)], abs=1e-12)
    assert reward == pytest.approx(
        99.99 + 70 + 50 + (1 - np.hypot(3.006, 3.988) / 15) * 50, abs=1e-4)


def test_touchdown_is_the_first_step_at_or_below_its_height() -> None:
    """At 5.2 m itself yes, a hair above no; the figures are those of that step."""
    assert end(placed((0.0, 5.2, 0.0)))[0] == 'landed'
    world = placed((0.0, np.nextafter(5.2, 6), 0.0))
    assert not world.step(IDLE)[2][0]
    falling = placed((0.0, 5.3, 0.0), (0.0, -2.0, 0.0))
    ends = [bool(falling.step(IDLE)[2][0]) for _ in range(3)]
    assert ends == [False, False, True]


@pytest.mark.parametrize(('outcome', 'position', 'tilt'), [
    ('tilt_limit', (0.0, 200.0, 0.0), 45.01), ('tilt_limit', (0.0, 401.0, 0.0), -45.01),
    ('out_of_bounds', (0.0, 400.01, 0.0), 0.0), ('out_of_bounds', (200.01, 200.0, 0.0), 0.0),
    ('out_of_bounds', (-200.01, 200.0, 0.0), 0.0), ('out_of_bounds', (0.0, 200.0, 200.01), 44.0),
    ('out_of_bounds', (0.0, 200.0, -200.01), 0.0),
])
def test_crashes_in_flight(
    outcome: str, position: tuple[float, float, float], tilt: float,
) -> None:
    """Each limit just passed, and tilt before bounds."""
    named, reward, _ = end(placed(position, tilt=tilt))
    assert named == outcome
    assert reward == pytest.approx(-100.01, abs=1e-5)


def test_limits_themselves_are_still_flight() -> None:
    """More than, not at: 45 deg less a rounding, 400 m, 200 m."""
    for world in (placed(tilt=44.9999), placed((200.0, 400.0, -200.0))):
        assert not world.step(IDLE)[2][0]


def test_touchdown_is_judged_before_the_flight_limits() -> None:
    """A rocket that passes every limit in the step in which it touches down has touched down."""
    for tilt, x, expected in ((0.0, 0.0, 'landed'), (50.0, 300.0, 'tipped'),
                              (0.0, 300.0, 'off_pad')):
        world = placed((x, 5.0, 0.0), tilt=tilt)
        world.age[:] = 1500
        assert end(world)[0] == expected


def test_timeout_is_at_step_1501_and_every_step_costs() -> None:
    """30 s are 1 500 steps, one more is too long; the last step costs as the others do."""
    world = placed()
    for _ in range(1500):
        _, reward, terminated, truncated, info = world.step(IDLE)
        assert reward[0] == np.float32(-0.01)
        assert not terminated[0]
        assert not truncated[0]
        assert not info['final_rows'].size
        assert not len(info['episodes'])
    outcome, last, info = end(world)
    assert outcome == 'timeout'
    assert last == pytest.approx(-100.01, abs=1e-5)
    assert info['episodes'].length.tolist() == [1501]
    assert info['episodes'].episode_return == pytest.approx([-115.01], abs=1e-9)


def test_timeout_comes_after_tilt_and_before_bounds() -> None:
    """Two limits in one step."""
    for tilt, y, expected in ((46.0, 200.0, 'tilt_limit'), (0.0, 500.0, 'timeout')):
        world = placed((0.0, y, 0.0), tilt=tilt)
        world.age[:] = 1500
        assert end(world)[0] == expected


def test_the_next_episode_begins_in_the_same_step() -> None:
    """Reward and last observation are of the episode that ended, the observation of the next."""
    world = worlds.make('rocket', 3, seed=4, level=8)
    other = worlds.make('rocket', 3, seed=4, level=8)
    world.position[:, 1] = [3.0, 5.0, 4.0]
    world.velocity[:, 1] = [0.0, -50.0, 0.0]
    observation, reward, terminated, _, info = world.step(np.tile([1.0, 0, 0], (3, 1)))
    assert terminated.tolist() == [False, True, False]
    assert info['final_rows'].tolist() == [1]
    assert info['final_observation'].shape == (1, 15)
    assert info['final_observation'].dtype == np.float32
    last = info['final_observation'][0]
    assert last[:3] == pytest.approx([3 / 50, 4 / 50, 4 / 50], abs=2e-3)
    assert last[4] == pytest.approx(-2.5, abs=0.02)
    assert reward == pytest.approx([-0.01, -100.01, -0.01], abs=1e-5)
    assert observation[1, 1] == 4
    assert (world.age.tolist(), world.episode.tolist()) == ([1, 0, 1], [0, 1, 0])
    assert world.fuel[1] == 2000
    assert world.episode_return == pytest.approx([-0.01, 0, -0.01])
    # Row 1 starts where its second episode always starts.
    assert np.array_equal(other.reset()[1], observation[1])


def test_the_first_sample_of_an_episode_has_no_data_of_an_earlier_step() -> None:
    """Telemetry of the new episode: no time, throttle, torque or reward of the one that ended."""
    world = placed((0.0, 5.0, 0.0))
    world.step(np.array([[1.0, 1.0, 1.0]]))
    assert world.finished.row.tolist() == [0]
    assert world.finished.reward[0] > 100
    assert world.finished.throttle[0] == 1
    first = world.telemetry(np.array([0]))
    assert first.episode[0] == 1
    assert (first.time[0], first.throttle[0], np.abs(first.torque).max()) == (0, 0, 0)
    assert first.reward[0] == 0
    world.step(IDLE)
    world.reset()
    assert world.telemetry(np.array([0])).reward[0] == 0


def test_returns_are_the_sums_of_rewards() -> None:
    """Over whole episodes of random flight; lengths and numbers of episodes count up."""
    world = worlds.make('rocket', 16, seed=2, level=8)
    sums, lengths, count, outcomes = np.zeros(16), np.zeros(16, int), np.zeros(16, int), set()
    for action in random_actions(1500, 16):
        _, reward, terminated, truncated, info = world.step(action)
        sums += reward
        lengths += 1
        rows, ended = info['final_rows'], info['episodes']
        assert np.array_equal(np.flatnonzero(terminated), rows)
        assert np.array_equal(ended.row, rows)
        assert not truncated.any()
        assert ended.episode_return == pytest.approx(sums[rows], abs=1e-3)
        assert np.array_equal(ended.length, lengths[rows])
        assert np.array_equal(ended.episode, count[rows])
        outcomes |= set(ended.outcome.tolist())
        sums[rows], lengths[rows] = 0, 0
        count[rows] += 1
    assert count.min() >= 3
    assert len(outcomes) >= 3


def test_equal_seeds_give_equal_bits_and_others_differ() -> None:
    """Over whole episodes, in all results of a step."""
    actions = random_actions(800, 8)
    one, same, other = (
        everything(worlds.make('rocket', 8, seed=s, level=8), actions) for s in (7, 7, 8))
    assert one[2].sum(axis=0).min() >= 1
    for a, b in zip(one, same, strict=True):
        assert np.array_equal(a, b)
    assert not (one[0] == other[0]).all(axis=2).any()


@pytest.mark.parametrize('num_envs', [1, 2, 3, 8, 31])
def test_a_rocket_does_not_depend_on_the_batch(num_envs: int) -> None:
    """Row k of a few equals row k of 64 under equal actions, bit for bit."""
    actions = random_actions(600, 64, seed=1)
    many = everything(worlds.make('rocket', 64, seed=3, level=8), actions)
    few = everything(worlds.make('rocket', num_envs, seed=3, level=8), actions[:, :num_envs])
    for a, b in zip(few, many, strict=True):
        assert np.array_equal(a, b[:, :num_envs])


def test_refused_actions_change_nothing() -> None:
    """Not finite, or of the wrong shape: the flight continues unchanged."""
    world = worlds.make('rocket', 2, seed=1, level=8)
    world.step(np.zeros((2, 3)))
    before = world.snapshot()
    for bad in (np.array([[0, 0, 0], [0, np.nan, 0]]), np.full((2, 3), np.inf), np.zeros((3, 3)),
                np.zeros(2), np.full((2, 3), True)):
        with pytest.raises(ValueError, match='action'):
            world.step(bad)
    assert world.snapshot() == before


def test_actions_out_of_range_fly_as_their_bounds() -> None:
    """Clipped, all three."""
    wild, bound = (worlds.make('rocket', 2, seed=1, level=8) for _ in range(2))
    wild.step(np.array([[9.0, -9.0, 1.5], [-9.0, 2.0, -1.01]]))
    bound.step(np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]]))
    assert wild.snapshot() == bound.snapshot()


def test_reset_without_seed_begins_the_next_episodes() -> None:
    """All numbers of episodes go up by one, and the starts are those of a natural end."""
    world = worlds.make('rocket', 4, seed=5, level=8)
    first = world.observe()
    second = world.reset()
    assert not (first == second).all(axis=1).any()
    assert world.episode.tolist() == [1] * 4
    assert not world.age.any()
    assert np.array_equal(world.reset(seed=5), first)
    assert world.episode.tolist() == [0] * 4
    world.position[1] = 5.0
    assert np.array_equal(world.step(np.tile(IDLE, (4, 1)))[0], second)


def test_reset_settings_hold_until_the_next_reset() -> None:
    """They lie on top of those the world was made with, in later episodes too."""
    world = worlds.make('rocket', 4, seed=5, level=1, spawn_height=150.0)
    assert world.observe()[:, 1] == pytest.approx(3.0)
    world.reset(level=8, spawn_height=100.0)
    world.position[1] = 5.0
    observation = world.step(np.tile(IDLE, (4, 1)))[0]
    assert observation[:, 1] == pytest.approx(2.0)
    assert np.abs(observation[:, 9:12]).min() > 0
    observation = world.reset()
    assert observation[:, 1] == pytest.approx(3.0)
    assert not observation[:, 9:12].any()


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'gravity': 3.0}, "unknown setting 'gravity', expected level"),
    ({'level': 9}, 'level: got 9, expected 1 to 8'),
    ({'level': 3, 'spawn_height': 500.0}, "'spawn_height': got 500.0"),
    ({'spawn_position': 300}, "'spawn_position': got 300"),
    ({'seed': 3, 'level': 0}, 'level: got 0'), ({'seed': -1}, 'seed: got -1'),
    ({'seed': 2**63}, r'0 to 2\*\*63 - 1'), ({'seed': 1.5}, 'seed'),
])
def test_a_refused_reset_changes_nothing(arguments: dict[str, Any], message: str) -> None:
    """Neither the flight nor the settings of the episodes to come."""
    world = worlds.make('rocket', 4, seed=5, level=2)
    world.step(np.zeros((4, 3)))
    before = world.snapshot()
    with pytest.raises(ValueError, match=message):
        world.reset(**arguments)
    assert world.snapshot() == before
