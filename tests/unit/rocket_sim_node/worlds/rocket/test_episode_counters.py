# SPDX-License-Identifier: Apache-2.0
"""Counters of episodes: fuel left, hovering, ignitions, effort."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import Episodes

STILL = {'spawn_angle': 0.0, 'spawn_position': 0.0, 'spawn_speed': 0.0}


def flown(actions: Any, **settings: Any) -> Episodes:
    """Return the one episode that actions `(T, 3)` fly until its time is up."""
    world = worlds.make('rocket', time_limit=(len(actions) - 1) * 0.02, **{**STILL, **settings})
    for action in actions:
        *_, info = world.step(np.array([action], float))
    episodes: Episodes = info['episodes']
    assert len(episodes) == 1
    return episodes


def test_the_time_of_hovering_is_counted() -> None:
    """Thrust equal to weight for 60 steps, falling with the engine off before that.

    Falling it takes 0.2 s to 1.962 m/s: then the engine holds that, below 2 m/s.
    """
    actions = [[-1, 0, 0]] * 10 + [[0, 0, 0]] * 60
    assert flown(actions).hover_time.tolist() == pytest.approx([60 * 0.02])
    assert flown([[-1, 0, 0]] * 12 + [[0, 0, 0]] * 60).hover_time.tolist() == [0.0]
    # A hand's breadth above touchdown counts as well.
    assert flown([[0, 0, 0]] * 60, spawn_height=5.3).hover_time.tolist() == pytest.approx([1.2])
    assert flown([[-1, 0, 0]] * 9).hover_time.tolist() == [0.0]  # slow, but not by its engine
    # After a cut-off, the thrust of an engine with a lag fades, but its engine is off.
    fading = flown(
        [[1, 0, 0]] * 5 + [[-1, 0, 0]] * 9, engine_lag_low=0.2, engine_lag_high=0.2)
    assert fading.hover_time.tolist() == pytest.approx([5 * 0.02])


def test_ignitions_are_counted() -> None:
    """From off to on; at or below the cut-off is off."""
    throttles = [0, 0.5, 1, 0.005, 0.5, 0, 0, 0.02, 0.5]
    assert flown([[2 * t - 1, 0, 0] for t in throttles]).ignitions.tolist() == [3]
    assert flown([[-1, 0, 0]] * 5).ignitions.tolist() == [0]


def test_fuel_used_and_left_add_up_to_the_drawn_fuel() -> None:
    """Full throttle for a second burns thrust / (Isp g) kilograms."""
    episodes = flown([[1, 0, 0]] * 50, fuel_factor=0.9)
    burnt = 470_880 / (282 * 9.81)
    assert episodes.fuel_used.tolist() == pytest.approx([burnt], rel=1e-9)
    assert episodes.fuel_left.tolist() == pytest.approx([1_800 - burnt], rel=1e-9)


def test_control_effort_is_the_mean_over_the_steps() -> None:
    """Change of the throttle, from off, and size of the torques: as commanded, and clipped."""
    actions = [[0.0, 0.01, 0.0], [1.0, 0.0, -0.02], [3.0, 0.0, 0.0], [-1.0, 0.01, 0.01]]
    effort = [0.5 + 0.01, 0.5 + 0.02, 0.0, 1.0 + 0.02]
    for settings in ({}, {'action_delay': 2}, {'throttle_floor': 0.6}):
        assert flown(actions, **settings).control_effort.tolist() == pytest.approx(
            [np.mean(effort)], rel=1e-12)


def test_the_counters_restart_with_each_episode() -> None:
    """All of it."""
    world = worlds.make('rocket', 2, time_limit=0.2, **STILL)
    seen = []
    for _ in range(22):
        *_, info = world.step(np.tile([0.0, 0.01, 0.0], (2, 1)))
        if len(info['episodes']):
            seen.append(info['episodes'])
    assert len(seen) == 2
    for name in ('hover_time', 'ignitions', 'control_effort', 'fuel_left', 'fuel_used'):
        first, second = (getattr(episodes, name) for episodes in seen)
        assert np.array_equal(first, second)
        assert first.all()


def test_the_counters_of_landers_are_zero() -> None:
    """Zeros, of the kinds of the rockets."""
    world = worlds.make('lunar_lander', 4)
    for _ in range(400):
        *_, info = world.step(np.full(4, 2))
        if len(info['episodes']):
            break
    episodes = info['episodes']
    assert len(episodes)
    for name in ('fuel_left', 'hover_time', 'control_effort', 'ignitions'):
        assert not getattr(episodes, name).any()
    assert episodes.ignitions.dtype == np.int64
