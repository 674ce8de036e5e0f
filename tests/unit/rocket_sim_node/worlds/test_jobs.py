# SPDX-License-Identifier: Apache-2.0
"""Flights in environments of this process: order, avoided restores, and ends."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import MAX_ATTEMPTS
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Results
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import Snapshot
from rocket_sim_node.worlds.jobs import fly

ACTION = np.zeros((2, 3), np.float32)


class Counting:
    """A world that counts what it is asked for, and fails when told to."""

    def __init__(self, failures: int = 0) -> None:
        self._world = make('rocket', num_envs=2)
        self.spec, self.calls, self._failures = self._world.spec, Counter[str](), failures

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            self.calls[name] += 1
            if name == 'step' and self._failures:
                self._failures -= 1
                raise EnvironmentRestarted('new session')
            return getattr(self._world, name)(*args, **options)

        return call


def begin(seed: int) -> Job[bytes]:
    """Reset, step and return the state."""
    yield Reset(seed, {'level': 7})
    yield ACTION
    state: bytes = yield Snapshot()
    return state


def go_on(state: bytes) -> Job[tuple[np.ndarray, bytes]]:
    """Step from a state; return what was seen at first, and the state."""
    first = yield Restore(state)
    yield ACTION
    return first, (yield Snapshot())


def test_a_flight_that_continues_from_the_last_end_needs_no_restore() -> None:
    world = Counting()
    fleet = SerialFleet(world)
    (state,) = fleet.fly([lambda: begin(1)])
    ((first, later),) = fleet.fly([lambda: go_on(state)])
    assert world.calls['restore'] == 0
    other = Counting()
    again, later_again = fly(other, go_on(state))
    assert other.calls['restore'] == 1
    np.testing.assert_array_equal(first, again)
    assert later == later_again
    # It has moved on since.
    ((_, repeated),) = fleet.fly([lambda: go_on(state)])
    assert world.calls['restore'] == 1
    assert repeated == later


def test_results_come_in_the_order_of_the_flights() -> None:
    one, two = SerialFleet(Counting()), SerialFleet(Counting(), Counting())
    flights = [lambda seed=seed: begin(seed) for seed in range(5)]
    assert list(one.fly(flights)) == list(two.fly(flights))


def test_a_lost_flight_is_repeated_and_reported() -> None:
    reports: list[str] = []
    fleet = SerialFleet(Counting(failures=2))
    assert list(fleet.fly([lambda: begin(3)], report=reports.append)) == [
        fly(make('rocket', num_envs=2), begin(3))]
    assert len(reports) == 2
    with pytest.raises(EnvironmentRestarted):
        list(SerialFleet(Counting(failures=MAX_ATTEMPTS)).fly([lambda: begin(3)]))


def test_a_poll_that_raises_ends_the_flight() -> None:
    ended = []

    def watched() -> Job[None]:
        try:
            yield Reset(1)
            yield ACTION
        finally:
            ended.append(True)

    polls = iter((None, EnvironmentClosed('asked to stop')))

    def poll() -> None:
        if (error := next(polls)) is not None:
            raise error

    with pytest.raises(EnvironmentClosed):
        list(SerialFleet(Counting()).fly([watched], poll))
    assert ended == [True]


def test_an_invalid_command_is_refused() -> None:
    def astray() -> Job[None]:
        yield Reset(1)
        yield [[0.0, 0.0, 0.0]] * 2  # type: ignore[misc]

    with pytest.raises(TypeError, match='got list, expected Reset, Restore, Snapshot, Act'):
        fly(make('rocket', num_envs=2), astray())


def test_results_are_recorded_before_the_next_answer() -> None:
    recorded: list[Results] = []

    def acting() -> Job[Any]:
        yield Reset(5)
        observation = yield Act(ACTION, recorded.append)
        assert len(recorded) == 1
        return observation, (yield Snapshot())

    def stepping() -> Job[Any]:
        yield Reset(5)
        observation, *results = yield ACTION
        for ours, theirs in zip(recorded[0][:3], results[:3], strict=True):
            np.testing.assert_array_equal(ours, theirs)
        return observation, (yield Snapshot())

    worlds = [make('rocket', num_envs=2) for _ in range(2)]
    (ours, state), (theirs, same) = fly(worlds[0], acting()), fly(worlds[1], stepping())
    np.testing.assert_array_equal(ours, theirs)
    assert state == same


def test_a_job_that_ends_without_its_last_results_is_refused() -> None:
    def ends() -> Job[None]:
        yield Reset(1)
        yield Act(ACTION, lambda results: None)

    with pytest.raises(TypeError, match='ended after Act, expected another command'):
        fly(make('rocket', num_envs=2), ends())
