# SPDX-License-Identifier: Apache-2.0
"""Snapshots of `rocket_planar` bring back the exact state, in touchdown too."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.invalid_data.forged_files import assert_value_refused

from rocket_sim_node import worlds
from rocket_sim_node.worlds.planar.world import RocketPlanarWorld

N = 40


def actions(steps: int, seed: int) -> Any:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, N, 3)) * (0.5, 1.0, 0.02)


def flown(steps: int = 90, num_envs: int = N) -> RocketPlanarWorld:
    """Return a world in which some fly, some slide or rock and some stand."""
    world = worlds.make(
        'rocket_planar', num_envs, seed=9, spawn_height=9.0, spawn_speed=0.5, spawn_angle=20.0,
        spawn_spin=0.2, landed_speed=8.0)
    assert isinstance(world, RocketPlanarWorld)
    for action in actions(steps, 1):
        world.step(action[:num_envs])
    return world


@pytest.mark.parametrize('steps', [0, 60, 90, 150])
def test_a_restored_world_continues_bit_for_bit(steps: int) -> None:
    world, other = flown(steps), flown(33)
    state, seen = world.snapshot(), world.observe()
    down = world._steps_down >= 0
    assert down.any() or steps == 0
    assert np.array_equal(other.restore(state), seen)
    assert other.snapshot() == state
    ended = 0
    for action in actions(400, 2):
        mine, theirs = world.step(action), other.step(action)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            assert np.array_equal(a, b)
        assert np.array_equal(
            mine[4]['episodes'].episode_return, theirs[4]['episodes'].episode_return)
        assert np.array_equal(
            world.telemetry(np.arange(N)).contact_force,
            other.telemetry(np.arange(N)).contact_force)
        ended += len(mine[4]['final_rows'])
    assert ended > N // 2
    assert world.snapshot() == other.snapshot()
    assert np.array_equal(world.reset(), other.reset())


@pytest.mark.parametrize('drawn', [
    {'fuel_factor_low': 0.5, 'fuel_factor_high': 0.9},
    {'dry_mass_factor_low': 1.1, 'dry_mass_factor_high': 1.2},
    {'dry_mass_factor_low': 0.8, 'dry_mass_factor_high': 0.9}])
def test_vehicles_outside_a_range_because_they_are_nominal_are_restored(
        drawn: dict[str, float]) -> None:
    world = worlds.make(
        'rocket_planar', N, seed=9, spawn_height=9.0, nominal_share=0.5, **drawn)
    for action in actions(90, 1):
        world.step(action)
        world.restore(world.snapshot())


def test_restoring_twice_is_the_same() -> None:
    world = flown()
    state = world.snapshot()
    first, again = (
        [world.restore(state), *(world.step(action)[0] for action in actions(100, 3))]
        for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_a_snapshot_changes_no_flight() -> None:
    """Neither in the air nor, but for rounding of the solver, on the ground."""
    world, other = flown(60), flown(60)
    for step, action in enumerate(actions(60, 4)):
        if step % 16 == 0:
            world.snapshot()
        mine, theirs = world.step(action)[0], other.step(action)[0]
        assert np.abs(mine - theirs).max() < 0.02


@pytest.mark.parametrize(('name', 'value', 'message'), [
    ('steps_down', -2, 'steps_down has a value below -1'),
    ('contact_still', -1, 'contact_still has a value below 0'),
    ('contact_mass', 0, 'contact_mass has a value outside 22000 to 24000 kg'),
    ('contact_start_x', 1e9, 'contact_start_x has a value outside the field'),
    ('contact_lanes_bodies', 1e9, 'bodies has a value beyond'),
    ('fuel', -1, 'fuel has a value below 0'),
    ('contact_speed', np.nan, 'contact_speed has a value that is not finite'),
    ('settings', 1, 'of a world with dt 1, expected 0.02'),
])
def test_impossible_values_are_refused(name: str, value: float, message: str) -> None:
    assert_value_refused(flown(), name, value, message)


def test_a_snapshot_of_another_world_is_refused() -> None:
    world = flown()
    with pytest.raises(ValueError, match="of world 'rocket', expected 'rocket_planar'"):
        world.restore(worlds.make('rocket', N).snapshot())
    with pytest.raises(ValueError, match='shape'):
        world.restore(flown(num_envs=3).snapshot())
