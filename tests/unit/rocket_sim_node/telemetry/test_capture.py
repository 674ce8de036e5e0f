# SPDX-License-Identifier: Apache-2.0
"""Telemetry of worlds: the state after a restore is the one of the snapshot."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.invalid_data.forged_files import contents
from support.invalid_data.forged_files import packed

from rocket_sim_node import worlds
from rocket_sim_node.telemetry.quantities import QUANTITIES
from rocket_sim_node.worlds.base import SimulatedWorld

LAST_STEP = {
    'rocket': {'torque', 'disturbance', 'reward'},
    'rocket_planar': {'reward', 'contact', 'contact_force'},
    'lunar_lander': {
        'throttle', 'commanded_throttle', 'thrust', 'lateral_thrust', 'torque', 'disturbance',
        'reward', 'contact_force'},
}
"""Quantities of the step that led to a state, which no later step depends on."""


def flown(name: str, seed: int = 5, steps: int = 60) -> SimulatedWorld:
    """Return eight vehicles after steps at random, some of them on the ground."""
    settings: dict[str, dict[str, Any]] = {
        'rocket': {'gust_deviation': 1.0, 'engine_lag': 0.2},
        'rocket_planar': {'spawn_height': 6.5, 'level': 1},
        'lunar_lander': {'enable_wind': True, 'spawn_reach': 0.3}}
    world = worlds.make(name, 8, seed, **settings[name])
    rng = np.random.default_rng(1)
    for _ in range(steps):
        world.step(rng.uniform(-1.0, 1.0, (8, world.spec.action_size)).astype(np.float32)
                   if world.spec.continuous else rng.integers(0, 4, 8))
    return world


@pytest.mark.parametrize('name', LAST_STEP)
def test_the_state_after_a_restore_is_that_of_the_snapshot(name: str) -> None:
    """All quantities are of one step, in the world that made it and in another."""
    world = flown(name)
    state = world.telemetry(slice(None))
    snapshot = world.snapshot()
    world.reset(7)
    for restored in (world, flown(name, 9, 20)):
        restored.restore(snapshot)
        again = restored.telemetry(slice(None))
        for quantity in QUANTITIES:
            values = state.arrays[quantity.name]
            assert np.array_equal(again.arrays[quantity.name], values), quantity.name
            assert quantity.name not in LAST_STEP[name] or values.any(), quantity.name
        assert restored.snapshot() == snapshot


@pytest.mark.parametrize('name', LAST_STEP)
def test_a_snapshot_without_the_results_of_the_last_step_is_restored(name: str) -> None:
    """Older versions do not store them: they are 0."""
    world = flown(name)
    arrays = contents(world.snapshot())
    for only_shown in world._last_step():  # type: ignore[attr-defined]
        del arrays[only_shown]
    world.restore(packed(arrays))
    state = world.telemetry(slice(None))
    for quantity in LAST_STEP[name]:
        assert not state.arrays[quantity].any(), quantity
