# SPDX-License-Identifier: Apache-2.0
"""Starts of `lunar_lander` below the usual height: setting `spawn_reach`."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.invalid_data.forged_files import assert_value_refused
from support.invalid_data.forged_files import contents

from rocket_sim_node import worlds
from rocket_sim_node.worlds import start_heights
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.lunar import vehicle
from rocket_sim_node.worlds.lunar import view
from rocket_sim_node.worlds.lunar.world import LANDED
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld

N = 64
FULL = worlds.full_reach(worlds.make('lunar_lander', 1).spec)
STEP = 0.5 * vehicle.START_PUSH * 0.02**2
"""m, more than the push moves a lander before its first observation."""


def make(**settings: Any) -> LunarLanderWorld:
    world = worlds.make('lunar_lander', N, 3, **settings)
    assert isinstance(world, LunarLanderWorld)
    return world


def heights(world: LunarLanderWorld) -> NDArray[np.float64]:
    """Return heights above touchdown, m."""
    height: NDArray[np.float64] = (
        view.hull_origin(world._lanes.pose[:, 0])[1] - vehicle.START_HEIGHT + FULL)
    return height


def speeds(world: LunarLanderWorld) -> NDArray[np.float64]:
    """Return horizontal speeds, m/s."""
    return world._lanes.velocity[:, 0, 0]


@pytest.mark.parametrize('reach', [2.0, FULL])
def test_starts_are_uniform_up_to_the_reach_with_a_push_in_proportion(reach: float) -> None:
    usual, world = make(), make(spawn_reach=reach)
    expected = reach * start_heights.reach_share(3, world.rows, world.episode)
    assert heights(usual) == pytest.approx(FULL, abs=STEP)
    assert heights(world) == pytest.approx(expected, abs=STEP)
    assert speeds(world) == pytest.approx(speeds(usual) * expected / FULL, abs=1e-6)
    assert np.array_equal(world.terrain, usual.terrain)


def test_a_reset_changes_the_reach_until_the_next() -> None:
    world = make(spawn_reach=2.0)
    world.reset(3, spawn_reach=0.0)
    assert np.array_equal(world.observe(), make().observe())
    assert world.flown_settings['spawn_reach'] == 0.0
    world.reset(3)
    assert np.array_equal(world.observe(), make(spawn_reach=2.0).observe())
    assert world.flown_settings['spawn_reach'] == 2.0
    with pytest.raises(ValueError, match=r'spawn_reach: got 9\.5, expected 0 to 9\.43'):
        world.reset(spawn_reach=9.5)


def test_the_lowest_starts_land_with_engines_off() -> None:
    world, outcomes = make(spawn_reach=0.01), []
    for _ in range(120):
        outcomes.extend(world.step(np.zeros(N, np.int64))[4]['episodes'].outcome.tolist())
    assert len(outcomes) >= N
    assert (np.array(outcomes) == LANDED).all()


def test_a_restored_world_goes_on_with_the_reach_of_the_snapshot() -> None:
    world = make()
    world.reset(5, spawn_reach=1.0)
    state = world.snapshot()
    other = make()
    other.restore(state)
    for _ in range(150):
        ours, theirs = (each.step(np.zeros(N, np.int64)) for each in (world, other))
        assert np.array_equal(ours[0], theirs[0])
    assert other.episode.min() > 0
    assert other.flown_settings['spawn_reach'] == 1.0


def test_a_snapshot_from_before_the_setting_has_the_usual_starts() -> None:
    """Flights from a file that such a version wrote (commit d86ee448), and from the same state."""
    def fly(world: SimulatedWorld, steps: int) -> NDArray[np.float32]:
        return np.array([world.step(np.array([0, 2]))[0] for _ in range(steps)])

    state = Path(__file__).with_name('before_spawn_reach.npz').read_bytes()
    assert 'spawn_reach' not in contents(state)
    older, world = (worlds.make('lunar_lander', 2, 7) for _ in range(2))
    older.reset(5, spawn_reach=1.0)
    older.restore(state)
    assert older.flown_settings['spawn_reach'] == 0.0
    fly(world, 40)  # as then
    ours = contents(world.snapshot())
    for name, theirs in contents(state).items():
        if name != 'world':
            # Another machine may compute other last bits.
            assert theirs == pytest.approx(ours[name], rel=1e-9, abs=1e-9), name
    assert fly(older, 300) == pytest.approx(fly(world, 300), abs=1e-5)
    assert older.episode.tolist() == world.episode.tolist() == [5, 3]


def test_a_forged_reach_changes_nothing() -> None:
    assert_value_refused(make(), 'spawn_reach', 1e3, 'snapshot: spawn_reach: got 1000')
