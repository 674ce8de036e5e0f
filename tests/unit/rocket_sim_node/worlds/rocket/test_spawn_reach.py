# SPDX-License-Identifier: Apache-2.0
"""Starts below the spawn height: uniform, in proportion, and unchanged without a reach."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from rocket_sim_node import worlds
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import start_heights
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket import spawn
from rocket_sim_node.worlds.rocket.vehicle import TaskSettings

COUNT = 20_000
ROWS = np.arange(COUNT)
FULL = 200.0 - 5.2


def drawn(episode: int = 0, **settings: Any) -> spawn.Spawn:
    task = TaskSettings(**settings)
    return spawn.draw(3, ROWS, np.full(COUNT, episode), spawn.spawn_range(task), task)


def share(episode: int = 0) -> worlds.base.F64:
    return start_heights.reach_share(3, ROWS, np.full(COUNT, episode))


@pytest.mark.parametrize('reach', [0.4, 60.0, FULL])
def test_heights_are_uniform_up_to_the_reach(reach: float) -> None:
    """Above 5.2 m, and exactly where `reach_share` says."""
    height = drawn(spawn_reach=reach).position[1] - 5.2
    assert height == pytest.approx(reach * share(), abs=1e-12)
    assert 0.0 < height.min() < 0.001 * reach < 0.999 * reach < height.max() <= reach
    assert stats.kstest(height, 'uniform', args=(0.0, reach)).pvalue > 1e-3


@pytest.mark.parametrize(('level', 'angle'), [(7, 20.0), (8, 20.0)])
def test_other_quantities_scale_with_the_height(
    level: int, angle: float,
) -> None:
    """At an angle that is never drawn again: one number of the stream is one angle."""
    whole = drawn(level=level, spawn_angle=angle)
    part = drawn(level=level, spawn_angle=angle, spawn_reach=60.0)
    times = (part.position[1] - 5.2) / FULL
    for ours, theirs in ((part.position[[0, 2]], whole.position[[0, 2]]),
                         (part.velocity, whole.velocity), (part.spin, whole.spin)):
        assert ours == pytest.approx(theirs * times, abs=1e-12)
    # The attitude: roll about z turns up into -x by its sine.
    roll, all_roll = (-np.arcsin(rotation.up_vector(s.attitude)[0]) for s in (part, whole))
    assert roll == pytest.approx(all_roll * times, abs=1e-7)


def test_the_full_reach_ends_in_the_whole_task() -> None:
    """The highest starts of 20 000 are those of the plain spawn but for a ten-thousandth."""
    top = np.argsort(share())[-3:]
    whole, part = drawn(), drawn(spawn_reach=FULL)
    for ours, theirs in zip(part, whole, strict=True):
        assert ours[:, top] == pytest.approx(theirs[:, top], rel=1e-3)
    assert spawn.full_reach(vars(TaskSettings())) == pytest.approx(FULL)


def test_without_a_reach_the_starts_are_unchanged_bit_for_bit() -> None:
    """The formulas of the plain spawn, from the first ten numbers of the episode's stream."""
    unit = random_streams.uniform(3, ROWS, np.full(COUNT, 4), 10)
    first = drawn(4, level=8)
    assert (first.position == [unit[0] * 50.0, np.full(COUNT, 200.0), unit[1] * 50.0]).all()
    assert (first.velocity == [unit[2] * 15.0, (unit[3] - 1) * 15.0, unit[4] * 15.0]).all()
    assert (first.spin == unit[5:8] * 0.3).all()


def test_the_height_is_independent_of_the_other_quantities() -> None:
    """A stream of its own: no correlation beyond four and a half deviations."""
    whole = drawn(level=8)
    for values in (*whole.position[[0, 2]], *whole.velocity, *whole.spin, share(1), share()[::-1]):
        assert abs(np.corrcoef(values, share())[0, 1]) < 4.5 / np.sqrt(COUNT)


@pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])
def test_a_reset_sets_the_reach_and_snapshots_keep_it(name: str) -> None:
    env = worlds.make(name, 200, 1)
    env.reset(seed=9, level=7, spawn_reach=2.0)
    expected = 2.0 * start_heights.reach_share(9, np.arange(200), np.zeros(200, int))
    assert env.position[1] - 5.2 == pytest.approx(expected, abs=1e-12)
    state = env.snapshot()
    fall = np.tile(np.float32([-1, 0, 0]), (200, 1))
    ended = [env.step(fall)[4]['episodes'] for _ in range(60)]
    count = np.bincount(np.concatenate([e.row for e in ended]), minlength=200)
    assert (count > 0).all()
    outcomes = np.concatenate([e.outcome for e in ended])
    assert (outcomes == env.spec.outcomes.index('too_fast')).any()
    began = env.position.copy()
    other = worlds.make(name, 200, 77)
    other.restore(state)
    for _ in range(60):
        other.step(fall)
    assert (other.position == began).all()
    env.reset(seed=9, level=7)
    assert (env.position[1] == 200.0).all()


def test_next_episodes_begin_by_their_own_share() -> None:
    """A fall from two decimetres ends within eleven steps: sqrt(2 0.2 / 9.81) s is ten."""
    env = worlds.make('rocket', 50, 1, spawn_reach=0.2)
    fall = np.tile(np.float32([-1, 0, 0]), (50, 1))
    for _ in range(11):
        rows = env.step(fall)[4]['final_rows']
        assert env.position[1, rows] - 5.2 == pytest.approx(
            0.2 * start_heights.reach_share(1, rows, env.episode[rows]), abs=1e-12)
    assert (env.episode > 0).all()


def test_a_reach_beyond_the_spawn_height_is_refused() -> None:
    message = "'spawn_reach': got 194.9.*less touchdown_height, 194.8 m"
    with pytest.raises(ValueError, match=message):
        worlds.make('rocket', spawn_reach=194.9)
    with pytest.raises(ValueError, match=message):
        worlds.make('rocket').reset(spawn_reach=194.9)
