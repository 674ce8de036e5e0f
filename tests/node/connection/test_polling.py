# SPDX-License-Identifier: Apache-2.0
"""Waiting for the next message of an exchange: polls briefly, then blocks."""
from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rocket_msgs import msg
from std_msgs.msg import Empty
from support.processes import wait_until

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node import polling
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.wire.node.polling import Polling
from rocket_sim_node.wire.node.polling import PollingWaitSet
from rocket_sim_node.wire.node.steady_clock import create_timer

PATIENCE = 10.0
PATIENT = Polling(seconds=PATIENCE, after=PATIENCE, serve_period=100.0, cores=2)


class Line:
    """A publisher of observations, and a wait set that waits for them."""

    def __init__(
        self, make_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, polling: Polling,
    ) -> None:
        self.looks = self.sleeps = 0
        self._step = 0
        sender, _ = make_node()
        node, executor = make_node()
        self.publisher = sender.create_publisher(msg.Observation, 'observation', qos.STREAM)
        self.observations = ArraySubscription(
            node, msg.Observation, 'observation', qos.read_stream('always'))
        self.wait_set = PollingWaitSet(node, executor, polling)
        make = self.wait_set._make

        def made(size: Any) -> None:
            make(size)
            self.wait_set._wait_set = Counting(self, self.wait_set._wait_set)

        monkeypatch.setattr(self.wait_set, '_make', made)
        give_way = os.sched_yield

        def counted() -> None:
            self.looks += 1
            give_way()

        monkeypatch.setattr(os, 'sched_yield', counted)
        while not self.publisher.get_subscription_count():
            executor.spin_once(timeout_sec=0.01)
        self.wait_set.wait([self.observations], 0.0)  # serves the rest of the node first
        self.sleeps = 0

    def send(self) -> None:
        """Publish the next step."""
        self._step += 1
        self.publisher.publish(msg.Observation(session=1, step=self._step))

    def receive(self) -> None:
        """Wait for it, and take it."""
        for _ in range(200):
            if self.observations in self.wait_set.wait([self.observations], PATIENCE)[0]:
                break
        assert self.observations.take().step == self._step


class Counting:
    """A wait set that counts its blocking waits."""

    def __init__(self, line: Line, wait_set: Any) -> None:
        self._line, self._wait_set = line, wait_set

    def __getattr__(self, name: str) -> Any:
        return getattr(self._wait_set, name)

    def wait(self, nanoseconds: int) -> None:
        self._line.sleeps += 1
        self._wait_set.wait(nanoseconds)


@pytest.fixture
def make_line(
        make_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Callable[..., Line]:
    def make(**changes: float) -> Line:
        return Line(make_node, monkeypatch, replace(PATIENT, **changes))

    return make


@pytest.fixture
def line(make_line: Callable[..., Line]) -> Line:
    return make_line()


def test_fast_exchanges_poll_without_sleeping(line: Line) -> None:
    line.send()
    line.receive()
    assert (line.looks, line.sleeps) == (0, 1)
    for _ in range(20):
        line.send()
        line.receive()
    assert line.sleeps == 1


def test_a_wait_after_a_long_wait_sleeps_without_polling(make_line: Callable[..., Line]) -> None:
    line = make_line(seconds=0.005)
    line.send()
    line.receive()
    assert line.wait_set.wait([line.observations], 0.01) == ([], False)
    looks = line.looks
    assert looks and line.sleeps == 2
    assert line.wait_set.wait([line.observations], 0.01) == ([], False)
    assert line.looks == looks and line.sleeps == 3


def test_a_machine_with_one_core_does_not_poll(make_line: Callable[..., Line]) -> None:
    line = make_line(cores=1)
    for _ in range(3):
        line.send()
        line.receive()
    assert line.looks == 0 and line.sleeps >= 3


def test_a_timer_that_is_due_is_served_amid_messages(line: Line) -> None:
    """A flood of messages must not delay the steps of real time."""
    served: list[None] = []
    timer = create_timer(line.observations._node, 0.001, lambda: served.append(None))
    for _ in range(50):
        line.send()
        while not line.wait_set.wait([line.observations], PATIENCE, timers=[timer])[0]:
            pass
        assert line.observations.take() is not None
        time.sleep(0.002)
    assert len(served) >= 40


def test_a_message_not_yet_taken_ends_the_wait_at_once(line: Line) -> None:
    line.send()
    wait_until(lambda: line.observations.full, PATIENCE)
    assert line.wait_set.wait([line.observations], PATIENCE) == ([line.observations], False)
    assert np.array_equal(line.observations.take().data, [])
    assert line.observations.take() is None


class Spins:
    """An executor that counts how often it is run."""

    def __init__(self, executor: Any) -> None:
        self._executor, self.count = executor, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._executor, name)

    def spin_once(self, timeout_sec: float) -> None:
        """Serve one callback."""
        self.count += 1
        self._executor.spin_once(timeout_sec=timeout_sec)


def test_serving_runs_what_is_due_and_then_ends(make_node: Callable[..., Any]) -> None:
    node, executor = make_node()
    if isinstance(executor, SingleThreadedExecutor):
        pytest.skip('this rclpy has no EventsExecutor')
    publisher = node.create_publisher(Empty, 'callbacks', 100)
    served: list[Any] = []
    node.create_subscription(Empty, 'callbacks', served.append, 100)
    discovered(executor, publisher)
    for due, most in ((0, 3), (3, 7), (16, 16)):
        served.clear()
        for _ in range(due):
            publisher.publish(Empty())
        assert publisher.wait_for_all_acked(Duration(seconds=20))
        spins: Any = Spins(executor)
        polling._serve(spins)
        assert len(served) == due
        assert spins.count <= most


def test_serving_runs_what_callbacks_make_due(make_node: Callable[..., Any]) -> None:
    """As actions do: their goal, their execution and their result are tasks of each other."""
    node, executor = make_node()
    publisher = node.create_publisher(Empty, 'callbacks', 100)
    links: list[int] = []

    def link() -> None:
        links.append(len(links))
        if len(links) < 4:
            executor.create_task(link)

    node.create_subscription(Empty, 'callbacks', lambda message: link(), 100)
    discovered(executor, publisher)
    publisher.publish(Empty())
    assert publisher.wait_for_all_acked(Duration(seconds=20))
    polling._serve(executor)
    assert links == [0, 1, 2, 3]


def test_serving_runs_a_due_timer(make_node: Callable[..., Any]) -> None:
    node, executor = make_node()
    served: list[None] = []
    create_timer(node, 0.001, lambda: served.append(None))
    missed = 0
    for _ in range(100):
        time.sleep(0.002)
        served.clear()
        polling._serve(executor)
        missed += not served
    assert missed < 20


def discovered(executor: Any, publisher: Any) -> None:
    """Wait until a publisher knows its subscription and no event is due."""
    def known() -> bool:
        executor.spin_once(timeout_sec=0.01)
        return bool(publisher.get_subscription_count())

    wait_until(known, PATIENCE)
    for _ in range(100):
        executor.spin_once(timeout_sec=0.0)
