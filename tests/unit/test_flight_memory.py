# SPDX-License-Identifier: Apache-2.0
"""A pilot's memory of a flight, and when it is forgotten."""
from __future__ import annotations

import numpy as np
import pytest

from ppo_agent_node.pilots.memory import FlightMemory
from ppo_agent_node.pilots.sight import look
from rocket_sim_node import worlds
from rocket_sim_node.worlds.vehicle import RocketSettings


def test_fuel_is_counted_exactly_while_the_engine_does_as_it_is_told() -> None:
    world = worlds.make('rocket', 5, seed=2, level=7)
    memory, throttle = FlightMemory(RocketSettings()), np.array([0.0, 0.3, 0.5, 0.8, 1.0])
    observation = world.observe()
    assert memory.look(look(observation, world.spec.settings)).all()
    for _ in range(100):
        memory.command(throttle)
        action = np.zeros((5, 3), np.float32)
        action[:, 0] = 2 * throttle - 1
        observation, *_ = world.step(action)
        assert not memory.look(look(observation, world.spec.settings)).any()
    assert memory.lit.tolist() == [False, True, True, True, True]
    assert 2000 - memory.burnt == pytest.approx(world.telemetry(slice(None)).fuel, rel=1e-6)


def test_a_row_is_forgotten_when_its_flight_does_not_go_on() -> None:
    world = worlds.make('rocket', 3, seed=2, level=7)
    settings, memory = world.spec.settings, FlightMemory(RocketSettings())
    memory.look(look(world.observe(), settings))
    for _ in range(150):
        memory.command(np.full(3, 0.4))
        observation, *_ = world.step(np.tile(np.array([-0.2, 0, 0], np.float32), (3, 1)))
        memory.look(look(observation, settings))
    burnt = memory.burnt.copy()
    elsewhere = observation.copy()
    elsewhere[0] = world.reset()[0]  # an episode begins
    elsewhere[1, 1] -= 1.0           # another rocket, in mid-air
    elsewhere[1, 13] += 1.0
    assert memory.look(look(elsewhere, settings)).tolist() == [True, True, False]
    assert (memory.burnt[0], memory.lit[0]) == (0.0, False)
    assert np.isnan(memory.burnt[1]) and not memory.lit[1]
    assert (memory.burnt[2], memory.lit[2]) == (burnt[2], True)
    assert memory.look(look(elsewhere[:2], settings)).all()
