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
from rocket_msgs import msg
from support.processes import wait_until

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node import inbox
from rocket_sim_node.wire.node.inbox import Inbox
from rocket_sim_node.wire.node.inbox import Mailbox
from rocket_sim_node.wire.node.inbox import Polling
from rocket_sim_node.wire.node.steady_clock import create_timer

PATIENCE = 10.0
PATIENT = Polling(seconds=PATIENCE, after=PATIENCE, serve_period=100.0, cores=2)


class Line:
    """A publisher of observations, and an inbox that waits for them."""

    def __init__(
        self, make_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, polling: Polling,
    ) -> None:
        self.looks = self.sleeps = 0
        self._step = 0
        sender, _ = make_node()
        node, executor = make_node()
        self.publisher = sender.create_publisher(msg.Observation, 'observation', qos.STREAM)
        self.box = Mailbox(node, msg.Observation, 'observation', qos.read_stream('always'))
        self.inbox = Inbox(node, executor, polling)
        make = self.inbox._make

        def made(size: Any) -> None:
            make(size)
            self.inbox._wait_set = Counting(self, self.inbox._wait_set)

        monkeypatch.setattr(self.inbox, '_make', made)
        give_way = os.sched_yield

        def counted() -> None:
            self.looks += 1
            give_way()

        monkeypatch.setattr(inbox.os, 'sched_yield', counted)
        while not self.publisher.get_subscription_count():
            executor.spin_once(timeout_sec=0.01)
        self.inbox.wait([self.box], 0.0)  # which serves the rest of the node, first of all
        self.sleeps = 0

    def send(self) -> None:
        """Publish the next step."""
        self._step += 1
        self.publisher.publish(msg.Observation(session=1, step=self._step))

    def receive(self) -> None:
        """Wait for it, and take it."""
        for _ in range(200):
            if self.box in self.inbox.wait([self.box], PATIENCE)[0]:
                break
        assert self.box.take().step == self._step


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
    assert line.inbox.wait([line.box], 0.01) == ([], False)
    looks = line.looks
    assert looks and line.sleeps == 2
    assert line.inbox.wait([line.box], 0.01) == ([], False)
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
    timer = create_timer(line.box._node, 0.001, lambda: served.append(None))
    for _ in range(50):
        line.send()
        while line.box not in line.inbox.wait([line.box], PATIENCE, timers=[timer])[0]:
            pass
        assert line.box.take() is not None
        time.sleep(0.002)
    assert len(served) >= 40


def test_a_message_not_yet_taken_ends_the_wait_at_once(line: Line) -> None:
    line.send()
    wait_until(lambda: line.box.full, PATIENCE)
    assert line.inbox.wait([line.box], PATIENCE) == ([line.box], False)
    assert np.array_equal(line.box.take().data, [])
    assert line.box.take() is None
