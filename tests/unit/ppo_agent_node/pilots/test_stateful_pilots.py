# SPDX-License-Identifier: Apache-2.0
"""A pilot's memory of a flight, and when it is reset."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppo_agent_node.commands import failures
from ppo_agent_node.commands import recorded_flights
from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.imitation.demonstrations import fly_clone
from ppo_agent_node.imitation.demonstrations import fly_wave
from ppo_agent_node.imitation.demonstrations import label
from ppo_agent_node.pilots.expert.memory import FlightMemory
from ppo_agent_node.pilots.expert.observed_state import look
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.jobs import fly
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings


def test_fuel_is_counted_exactly_while_the_engine_follows_commands() -> None:
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


def test_the_memory_of_a_row_is_reset_when_its_flight_ends() -> None:
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


TIPPING: dict[str, Any] = {
    'level': 7, 'spawn_angle': 85.0, 'spawn_spin': 1.0, 'spawn_speed': 0.0, 'seed': 3}
"""Starts most of which tip over within a second, after a fall of less than 5 m."""


def test_heights_alone_miss_an_episode_that_begins_at_the_last_height() -> None:
    """So pilots are informed: rockets that tip over at once begin again where they ended."""
    world = worlds.make('rocket', 8, **TIPPING)
    settings = world.spec.settings
    guessing, informed = FlightMemory(RocketSettings()), FlightMemory(RocketSettings())
    informed.begin()
    observation, missed = world.observe(), 0
    for _ in range(100):
        guess = guessing.look(look(observation, settings))
        informed.look(look(observation, settings))
        for memory in (guessing, informed):
            memory.command(np.ones(8))
        observation, *_, info = world.step(np.tile(np.array([1, 0, 0], np.float32), (8, 1)))
        rows = info['final_rows']
        informed.begin(rows)
        missed += len(rows) - np.count_nonzero(guess[rows])
        fuel = world.telemetry(slice(None)).fuel
        full = informed.burnt.copy()
        full[rows] = 0.0
        assert 2000 - full == pytest.approx(fuel, rel=1e-6)
    assert missed > 8


def test_sensor_noise_does_not_reset_the_memory_of_a_flight() -> None:
    """With 50 m of noise the heights jump, and the fuel is still counted."""
    world = worlds.make(
        'rocket', 4, seed=1, level=7, sensor_noise_low=100.0, sensor_noise_high=100.0)
    memory, settings = FlightMemory(RocketSettings()), world.spec.settings
    memory.begin()
    assert memory.look(look(world.observe(), settings)).all()
    for _ in range(50):
        memory.command(np.ones(4))
        observation, *_ = world.step(np.tile(np.array([1, 0, 0], np.float32), (4, 1)))
        assert not memory.look(look(observation, settings)).any()
    assert 2000 - memory.burnt == pytest.approx(world.telemetry(slice(None)).fuel, rel=1e-6)


class Listening:
    """Steers nothing; compares the announced episodes with the starts that it observes."""

    name = 'listening'
    begun: list[list[int]]

    def __init__(self) -> None:
        """Create an empty list of episodes, which all copies share."""
        self.begun = []

    def __deepcopy__(self, memo: object) -> Listening:
        return self

    def __call__(self, observation: F32) -> NDArray[Any]:
        return np.zeros((len(observation), 3), np.float32)

    def begin(self, rows: NDArray[np.int64] | None = None) -> None:
        self.begun.append([] if rows is None else rows.tolist())


def test_pilots_are_informed_of_new_episodes_in_all_flights(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """First of all rows, then of each that finished, in the order of the steps."""
    world = worlds.make('rocket', 6, seed=0, level=7, spawn_height=30.0, spawn_angle=80.0)
    finished: list[list[int]] = []
    step = world.step

    def record(action: NDArray[Any]) -> Any:
        answer = step(action)
        if len(rows := answer[-1]['final_rows']):
            finished.append(rows.tolist())
        return answer

    monkeypatch.setattr(world, 'step', record)
    config = DemonstrationConfig(demonstration_noise=0.0)
    for flown in (
        lambda pilot: evaluate(world, pilot, 30, 5),
        lambda pilot: recorded_flights.fly(world, pilot, 5),
        lambda pilot: failures.fly_again(world, pilot, 5, [(0, 1), (3, 2)]),
        lambda pilot: fly(world, fly_wave(world.spec, pilot, config, {'level': 7}, 1, 0)),
        lambda pilot: label(
            world.spec, pilot, [fly(world, fly_clone(Listening(), {'level': 7}, 1))]),
    ):
        finished.clear()
        pilot = Listening()
        flown(pilot)
        assert pilot.begun == [[], *finished]
        assert len(finished) > 1
