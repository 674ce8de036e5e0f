# SPDX-License-Identifier: Apache-2.0
"""Conditions are exact: independent of the batch, of when they are drawn, and of snapshots."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.invalid_data.forged_files import assert_refused
from support.invalid_data.forged_files import assert_value_refused
from support.invalid_data.forged_files import contents
from support.invalid_data.forged_files import packed

from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket.world import RocketWorld

BOTH = pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])
N = 24
EVERYTHING = {
    'conditions': 'harsh', 'throttle_floor': (0.0, 0.4), 'ignitions': 9, 'wind_speed': (0, 10),
    'observation': 'extended', 'level': 8, 'spawn_height': 60.0}


def actions(steps: int, num_envs: int = N, seed: int = 1) -> Any:
    """Return random flights that come down."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (steps, N, 3))[:, :num_envs] * (0.9, 0.02, 0.02)


def make(name: str, num_envs: int = N, seed: int = 9, **settings: Any) -> RocketWorld:
    """Return a world of a rocket."""
    world = worlds.make(name, num_envs, seed, **settings)
    assert isinstance(world, RocketWorld)
    return world


def same(mine: Any, theirs: Any) -> None:
    """Assert that two worlds answered a step alike, bit for bit."""
    for a, b in zip(mine[:4], theirs[:4], strict=True):
        assert np.array_equal(a, b)
    for field in Episodes.__dataclass_fields__:
        assert np.array_equal(
            getattr(mine[4]['episodes'], field), getattr(theirs[4]['episodes'], field)), field


@BOTH
def test_a_restored_world_flies_on_bit_for_bit(name: str) -> None:
    """In midst of flight under all conditions; through ends of episodes and new draws."""
    world, other = make(name, **EVERYTHING), make(name, seed=1, **EVERYTHING)
    other.reset(conditions='nominal')
    for action in actions(70):
        world.step(action)
    state, seen = world.snapshot(), world.observe()
    assert np.array_equal(other.restore(state), seen)
    assert other.snapshot() == state
    for column in ('engine_lag', 'gust_deviation'):
        assert world.telemetry(slice(None)).conditions[
            :, conditions.DRAWN_NAMES.index(column)].all()
    ended = 0
    for action in actions(500, seed=2):
        mine, theirs = world.step(action), other.step(action)
        same(mine, theirs)
        ended += len(mine[4]['final_rows'])
        for field in ('throttle', 'disturbance', 'conditions', 'mass', 'commanded_throttle'):
            assert np.array_equal(getattr(world.telemetry(slice(None)), field),
                                  getattr(other.telemetry(slice(None)), field))
    assert ended > 2 * N
    assert world.snapshot() == other.snapshot()
    assert np.array_equal(world.reset(), other.reset())


@BOTH
@pytest.mark.parametrize('num_envs', [1, 5])
def test_a_rocket_does_not_depend_on_the_batch(name: str, num_envs: int) -> None:
    """Nor on its neighbours."""
    world, few = make(name, **EVERYTHING), make(name, num_envs, **EVERYTHING)
    assert np.array_equal(world.observe()[:num_envs], few.observe())
    for action in actions(300):
        mine, theirs = world.step(action), few.step(action[:num_envs])
        for a, b in zip(mine[:3], theirs[:3], strict=True):
            assert np.array_equal(a[:num_envs], b)


@BOTH
def test_equal_seeds_are_equal_and_others_differ(name: str) -> None:
    one, two, other = (make(name, seed=seed, conditions='harsh') for seed in (4, 4, 5))
    for action in actions(200):
        same(one.step(action), two.step(action))
        other.step(action)
    drawn = [world.telemetry(slice(None)).conditions[:, 0] for world in (one, other)]
    assert (drawn[0] != drawn[1]).all()


@BOTH
def test_nominal_conditions_are_the_world_as_it_was(name: str) -> None:
    """Bit for bit, also in a world made for others and after flights under others."""
    default, named, back = make(name), make(name, conditions='nominal'), make(
        name, conditions='harsh')
    for action in actions(40):
        back.step(action)
    back.reset(seed=9, conditions='nominal')
    for action in actions(400):
        step = default.step(action)
        same(step, named.step(action))
        same(step, back.step(action))
    assert default.snapshot() == named.snapshot()


@BOTH
def test_conditions_of_an_earlier_reset_leave_nothing_behind(name: str) -> None:
    """A steady push follows gusts: it is that of a world in which no gust ever blew."""
    world, fresh = make(name), make(name)
    world.reset(3, conditions='harsh')
    for action in actions(20):
        world.step(action)
    for settings in ({'side_acceleration': 1.0}, {}):
        assert np.array_equal(world.reset(5, **settings), fresh.reset(5, **settings))
        for action in actions(30):
            same(world.step(action), fresh.step(action))
        mine, theirs = world.telemetry(slice(None)), fresh.telemetry(slice(None))
        assert np.array_equal(mine.disturbance, theirs.disturbance)
        assert mine.disturbance.any() == bool(settings)
        assert world.snapshot() == fresh.snapshot()


def test_the_next_episode_draws_new_conditions() -> None:
    """And begins with an empty line, an engine that is off and a gust of its own."""
    world = make('rocket', 3, conditions='harsh', time_limit=0.4, action_delay=4)
    first = world.telemetry(slice(None)).conditions
    for _ in range(21):
        step = world.step(np.ones((3, 3)) * (1.0, 0.0, 0.0))
    assert step[2].all()
    second = world.telemetry(slice(None))
    names = conditions.DRAWN_NAMES
    for name in ('dry_mass_factor', 'engine_lag', 'side_direction', 'gust_deviation'):
        assert (first[:, names.index(name)] != second.conditions[:, names.index(name)]).all()
    assert not second.throttle.any()
    for _ in range(4):
        world.step(np.ones((3, 3)))
        assert not world.telemetry(slice(None)).throttle.any()
    world.step(np.ones((3, 3)))
    assert world.telemetry(slice(None)).throttle.all()


def test_effects_out_of_the_plane_are_left_out() -> None:
    """In `rocket_planar`, under all conditions."""
    world = make('rocket_planar', **EVERYTHING)
    for action in actions(200):
        world.step(action)
        assert not world.position[2].any()
        assert not world.velocity[2].any()
        assert not world.observe()[:, 2:9:3].any()
        assert not world.telemetry(slice(None)).disturbance[:, 1:].any()


def test_the_ground_carries_the_drawn_mass() -> None:
    """The ground carries dry mass times its factor and what fuel is left."""
    world = make('rocket_planar', 6, dry_mass_factor=(0.9, 1.1), spawn_height=5.5,
                 spawn_angle=0.0, spawn_position=0.0, spawn_speed=0.0, rest_time=1.0,
                 touchdown_limit=2.0)
    for _ in range(50):
        world.step(np.tile([-1.0, 0.0, 0.0], (6, 1)))
    telemetry = world.telemetry(slice(None))
    assert telemetry.contact.all()
    factor = telemetry.conditions[:, 0]
    assert np.allclose(telemetry.mass, 22_000 * factor + 2_000)
    assert np.allclose(telemetry.contact_force[:, 1], telemetry.mass * 9.81, rtol=1e-3)
    assert factor.max() - factor.min() > 0.05


@BOTH
@pytest.mark.parametrize(('array', 'value', 'message'), [
    ('commands', 1.5, 'commands has a value outside -1 to 1'),
    ('commanded', -2.0, 'commanded has a value outside -1 to 1'),
    ('throttle', 1.01, 'throttle has a value outside 0 to 1'),
    ('ignitions', -1, 'ignitions has a value below 0'),
    ('hover', -1, 'hover has a value below 0'),
    ('gust', np.inf, 'gust has a value that is not finite'),
    ('accelerations', np.nan, 'accelerations has a value that is not finite'),
])
def test_a_forged_state_is_refused(name: str, array: str, value: float, message: str) -> None:
    """By name, and nothing changes."""
    assert_value_refused(make(name, **EVERYTHING), array, value, f'snapshot: {message}')


@BOTH
def test_a_line_of_another_length_is_refused(name: str) -> None:
    """It has to be as long as the delay in the snapshot itself."""
    world = make(name, action_delay=3)
    before = world.snapshot()
    arrays = contents(before)
    arrays['commands'] = arrays['commands'][:2]
    assert_refused(world, packed(arrays), 'snapshot: commands has 2 steps, expected 4')
    world.reset(seed=1, action_delay=0)
    world.restore(before)
    assert world.snapshot() == before


def test_more_fuel_than_drawn_is_refused() -> None:
    """In `rocket_planar`, whose ground would have to carry it."""
    world = make('rocket_planar', fuel_factor=(1.0, 1.5))
    assert_value_refused(world, 'fuel', 3_001.0, 'snapshot: fuel has a value above 3000 kg')
