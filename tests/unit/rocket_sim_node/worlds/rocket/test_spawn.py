# SPDX-License-Identifier: Apache-2.0
"""Where episodes begin: the curriculum's table, bounds, and the laws of the draws."""
from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket import spawn
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings
from rocket_sim_node.worlds.rocket.vehicle import TaskSettings

F64 = NDArray[np.float64]
COUNT = 20_000
TABLE = {
    1: (5, 0, 0, 0), 2: (10, 0, 0, 0), 3: (20, 0, 0, 0), 4: (35, 0, 0, 0), 5: (35, 3, 0, 0),
    6: (35, 5, 0, 0), 7: (35, 5, 2, 0), 8: (35, 50, 15, 0.3),
}
"""Angle (deg), position (m), speed (m/s), spin (rad/s) of each level."""


@cache
def drawn(level: int, seed: int = 1, episode: int = 0) -> dict[str, F64]:
    """Return what 20 000 rockets spawn with, by name; pitch and roll in degrees."""
    task = TaskSettings(level=level)
    first = spawn.draw(seed, np.arange(COUNT), np.full(COUNT, episode),
                       spawn.spawn_range(task), task)
    up = rotation.up_vector(first.attitude)
    values = [*first.position, *first.velocity, *first.spin,
              np.rad2deg(np.arctan2(up[2], up[1])), np.rad2deg(-np.arcsin(up[0])),
              np.rad2deg(np.arccos(up[1]))]
    names = ('x', 'y', 'z', 'vx', 'vy', 'vz', 'wx', 'wy', 'wz', 'pitch', 'roll', 'tilt')
    return dict(zip(names, values, strict=True))


def bounds(level: int) -> dict[str, tuple[float, float]]:
    """Return the range of each quantity by the table."""
    angle, place, speed, spin = TABLE[level]
    return {
        'x': (-place, place), 'z': (-place, place), 'y': (200, 200),
        'vx': (-speed, speed), 'vy': (-2 * speed, 0), 'vz': (-speed, speed),
        'wx': (-spin, spin), 'wy': (-spin, spin), 'wz': (-spin, spin),
        'pitch': (-angle, angle), 'roll': (-angle, angle), 'tilt': (0, 45),
    }


def within_the_limit(width: float, limit: float) -> Callable[[F64], F64]:
    """Return the distribution of pitch when the tilt of (pitch, roll) may not pass the limit.

    At pitch p roll is free up to acos(cos limit / cos p), so the density of p is that or `width`,
    whichever is less (deg).
    """
    grid = np.linspace(-width, width, 20_001)
    free = np.rad2deg(np.arccos(np.clip(
        np.cos(np.radians(limit)) / np.cos(np.radians(grid)), -1, 1)))
    density = np.minimum(width, free)
    cumulated = np.concatenate(([0], np.cumsum((density[1:] + density[:-1]) / 2)))
    return lambda angle: np.interp(angle, grid, cumulated / cumulated[-1])


def beyond_the_limit(width: float, limit: float) -> float:
    """Return the share of uniform (pitch, roll) in `width` that tilts beyond the limit (deg)."""
    pitch = np.radians(np.linspace(0, width, 20_001))
    free = np.rad2deg(np.arccos(np.clip(np.cos(np.radians(limit)) / np.cos(pitch), -1, 1)))
    return float(np.mean(1 - np.minimum(width, free) / width))


def test_the_levels_are_those_of_the_specification() -> None:
    """Eight rows of four."""
    assert {level: (r.angle, r.position, r.speed, r.spin)
            for level, r in spawn.LEVELS.items()} == TABLE


@pytest.mark.parametrize('level', TABLE)
def test_all_draws_are_within_the_levels_ranges(level: int) -> None:
    """And reach nearly to both ends; what has no width is exact."""
    for name, (low, high) in bounds(level).items():
        values = drawn(level)[name]
        if low == high:
            assert (values == low).all(), name
            continue
        assert values.min() >= low - 1e-6, name
        assert values.max() <= high + 1e-6, name
        if name != 'tilt':
            assert values.min() < low + 0.01 * (high - low), name
            assert values.max() > high - 0.01 * (high - low), name


@pytest.mark.parametrize('level', TABLE)
def test_all_draws_are_uniform(level: int) -> None:
    """Kolmogorov-Smirnov; where the tilt limit bites, against the law it leaves."""
    for name, (low, high) in bounds(level).items():
        if low == high or name == 'tilt':
            continue
        if name in ('pitch', 'roll') and level >= 4:
            continue
        test = stats.kstest(drawn(level)[name], 'uniform', args=(low, high - low))
        assert test.pvalue > 1e-3, name


def test_attitudes_beyond_the_tilt_limit_are_drawn_again() -> None:
    """At 35 deg one in a hundred is; pitch and roll have the density that the limit leaves."""
    values = drawn(4)
    assert 44.5 < values['tilt'].max() <= 45
    law = within_the_limit(35, 45)
    # The cosine of tilt is cos pitch cos roll, so both angles have the same law.
    for name in ('pitch', 'roll'):
        assert stats.kstest(values[name], law).pvalue > 1e-3, name
    free = TaskSettings(level=4, tilt_limit=180.0)
    first = spawn.draw(1, np.arange(COUNT), np.zeros(COUNT, int), spawn.spawn_range(free), free)
    assert np.mean(rotation.up_vector(first.attitude)[1] < np.cos(np.pi / 4)) == pytest.approx(
        beyond_the_limit(35, 45), abs=4 * np.sqrt(0.01 / COUNT))


def test_a_narrow_tilt_limit_takes_many_draws() -> None:
    """In 35 deg with a limit of 10 one attempt in sixteen will do; the law is not uniform."""
    task = TaskSettings(level=4, tilt_limit=10.0)
    first = spawn.draw(3, np.arange(5000), np.zeros(5000, int), spawn.spawn_range(task), task)
    up = rotation.up_vector(first.attitude)
    assert np.rad2deg(np.arccos(up[1].min())) <= 10
    pitch = np.rad2deg(np.arctan2(up[2], up[1]))
    assert stats.kstest(pitch, within_the_limit(10, 10)).pvalue > 1e-3
    assert stats.kstest(pitch, 'uniform', args=(-10, 20)).pvalue < 1e-9


def test_a_redraw_leaves_the_rest_of_the_spawn() -> None:
    """Position, velocity and spin are drawn once."""
    task = TaskSettings(level=8)
    strict = TaskSettings(level=8, tilt_limit=20.0)
    rows, episodes = np.arange(1000), np.zeros(1000, int)
    one = spawn.draw(1, rows, episodes, spawn.spawn_range(task), task)
    two = spawn.draw(1, rows, episodes, spawn.spawn_range(strict), strict)
    assert np.array_equal(one.position, two.position)
    assert np.array_equal(one.velocity, two.velocity)
    assert np.array_equal(one.spin, two.spin)
    kept = rotation.up_vector(one.attitude)[1] >= np.cos(np.deg2rad(20.0))
    assert 0.1 < kept.mean() < 0.9
    assert np.array_equal(one.attitude[:, kept], two.attitude[:, kept])


def test_quantities_rows_and_episodes_are_independent() -> None:
    """No correlation beyond four and a half deviations (66 pairs)."""
    free = [n for n in drawn(8) if n not in ('y', 'tilt')]
    matrix = np.corrcoef([drawn(8)[name] for name in free])
    worst = np.abs(matrix - np.eye(len(free))).max()
    assert worst < 4.5 / np.sqrt(COUNT)
    for name in free:
        now, later = drawn(8)[name], drawn(8, episode=1)[name]
        assert abs(np.corrcoef(now, later)[0, 1]) < 4.5 / np.sqrt(COUNT), name
        assert abs(np.corrcoef(now[1:], now[:-1])[0, 1]) < 4.5 / np.sqrt(COUNT), name


@pytest.mark.parametrize('level', TABLE)
def test_no_episode_starts_terminated(level: int) -> None:
    """After one idle step of 0.1 ms 1 000 rockets of every level fly on."""
    world = worlds.make('rocket', 1000, 5, level=level, dt=1e-4)
    assert not world.step(np.tile([-1.0, 0, 0], (1000, 1)))[2].any()
    assert world.fuel == pytest.approx(2000)


@pytest.mark.parametrize(('name', 'value'), [
    ('spawn_angle', 2.5), ('spawn_position', 7.5), ('spawn_speed', 1.25), ('spawn_spin', 0.15),
])
def test_a_custom_range_need_not_be_a_whole_number(name: str, value: float) -> None:
    """It replaces the level's, and leaves the others."""
    world = worlds.make('rocket', 4000, **{'level': 8, name: value})  # type: ignore[arg-type]
    largest = {
        'spawn_angle': np.rad2deg(np.arcsin(np.abs(rotation.up_vector(world.attitude)[0]))),
        'spawn_position': np.abs(world.position[[0, 2]]),
        'spawn_speed': np.abs(world.velocity[[0, 2]]),
        'spawn_spin': np.abs(world.spin),
    }
    for key, level_value in zip(spawn.SPAWN_SETTINGS, TABLE[8], strict=True):
        expected = value if key == name else level_value
        assert largest[key].max() == pytest.approx(expected, rel=0.02), key
    assert world.velocity[1].min() == pytest.approx(
        -2 * (value if name == 'spawn_speed' else 15), rel=0.02)


def test_zero_is_a_valid_range() -> None:
    """Not mistaken for `by level`."""
    world = worlds.make('rocket', 50, level=8, spawn_angle=0, spawn_position=0, spawn_speed=0,
                        spawn_spin=0, spawn_height=150.0)
    assert (world.position == np.array([[0], [150], [0]])).all()
    assert not world.velocity.any()
    assert not world.spin.any()
    assert (rotation.up_vector(world.attitude) == np.array([[0], [1], [0]])).all()


@pytest.mark.parametrize(('settings', 'message'), [
    ({'spawn_position': 201}, "'spawn_position': got 201.*range_limit, 200"),
    ({'spawn_height': 5.2}, "'spawn_height': got 5.2.*touchdown_height, 5.2"),
    ({'spawn_height': 400.1}, "'spawn_height': got 400.1.*height_limit, 400"),
    ({'tilt_limit': 0.0}, "'spawn_angle': got .*, expected at most 4 times tilt_limit, 0.0 deg"),
    ({'spawn_angle': 180, 'tilt_limit': 1e-3},
     "'spawn_angle': got 180.0, expected at most 4 times tilt_limit, 0.001"),
])
def test_a_start_outside_the_field_is_refused(
    settings: dict[str, Any], message: str,
) -> None:
    """By name, when the world is made and when it is reset."""
    with pytest.raises(ValueError, match=message):
        worlds.make('rocket', **settings)
    if set(settings) <= set(spawn.CURRICULUM_SETTINGS):
        with pytest.raises(ValueError, match=message):
            worlds.make('rocket').reset(**settings)


def test_reset_takes_the_settings_of_the_curriculum_and_conditions() -> None:
    """Those and no more."""
    assert worlds.reset_settings('rocket') == (
        'level', 'spawn_height', 'spawn_angle', 'spawn_position', 'spawn_speed', 'spawn_spin',
        'spawn_reach', 'spawn_copies', *conditions.FLAT_NAMES)
    assert set(spawn.CURRICULUM_SETTINGS) <= set(RocketSettings.__dataclass_fields__)
