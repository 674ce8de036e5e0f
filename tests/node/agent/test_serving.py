# SPDX-License-Identifier: Apache-2.0
"""The goals of `Actions` in this process, whatever happens to their execution."""
from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.node import Node
from rocket_msgs.action import Land
from support.processes import Processes
from support.processes import wait_until

from ppo_agent_node.nodes.actions import serving
from ppo_agent_node.nodes.actions.flight_figures import no_figures
from rocket_sim_node.wire.node import deferred_action_server
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.running import make_executor


class Execution:
    """Stands in for the processes of a goal."""

    error: Exception | None = None
    """raised by the result"""

    def __init__(self, command: str, goal: Any, namespace: str, scratch: Path) -> None:
        """Begin."""
        self.command, self.scratch, self.killed = command, scratch, False
        self.statistics = SimpleNamespace(figures=no_figures, text=str)
        self.process = SimpleNamespace(ended=True, interrupt=lambda: None, kill=self._kill)

    def _kill(self) -> None:
        self.killed = True

    def result(self, stopped: str) -> Any:
        """Return the result."""
        if self.error is not None:
            raise self.error
        return Land.Result(code=Land.Result.OK, message=stopped, figures=no_figures())


class Bench:
    """The actions and their client, on one executor."""

    def __init__(self, context: Context) -> None:
        """Create both."""
        self.node = Node('served', context=context)
        self.executor = make_executor(context)
        self.executor.add_node(self.node)
        self.actions = serving.Actions(self.node)
        self.client = ActionClient(self.node, Land, 'land')

    def wait(self, done: Callable[[], bool]) -> None:
        """Serve until it is done."""
        def look() -> bool:
            self.executor.spin_once(timeout_sec=0.05)
            self.actions.poll()
            return done()

        wait_until(look, 20.0)

    def begin(self) -> Any:
        """Send a goal; return the future of its result."""
        self.wait(self.client.server_is_ready)
        sent = self.client.send_goal_async(Land.Goal())
        self.wait(sent.done)
        return sent.result().get_result_async()

    def land(self) -> tuple[int, Any]:
        """Return status and result of a goal."""
        asked = self.begin()
        self.wait(asked.done)
        return asked.result().status, asked.result().result


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Execution]:
    """All executions."""
    found: list[Execution] = []

    def make(*arguments: Any) -> Execution:
        found.append(Execution(*arguments))
        return found[-1]

    monkeypatch.setattr(serving, 'Execution', make)
    return found


@pytest.fixture
def bench(
    processes: Processes, monkeypatch: pytest.MonkeyPatch, made: list[Execution],
) -> Iterator[Bench]:
    """The actions, with executions that end at once."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    context = Context()
    rclpy.init(context=context, domain_id=processes.domain)
    yield Bench(context)
    rclpy.shutdown(context=context)


def test_the_folder_and_the_processes_of_a_goal_are_gone_with_its_result(
        bench: Bench, made: list[Execution]) -> None:
    for number in range(2):
        status, result = bench.land()
        assert (status, result.code) == (GoalStatus.STATUS_SUCCEEDED, Land.Result.OK)
        assert made[number].killed
        assert not made[number].scratch.exists()
    assert not bench.actions.busy


@pytest.mark.parametrize('error', [
    ValueError('no figures'), KeyError('landed'), OSError(5, 'Input/output error')])
def test_a_goal_whose_result_cannot_be_read_is_answered(
        bench: Bench, made: list[Execution], monkeypatch: pytest.MonkeyPatch, error: Exception,
) -> None:
    monkeypatch.setattr(Execution, 'error', error)
    status, result = bench.land()
    assert (status, result.code) == (GoalStatus.STATUS_ABORTED, Land.Result.FAILED)
    assert result.message.startswith('land: the figures cannot be read: ')
    assert not made[0].scratch.exists()
    monkeypatch.setattr(Execution, 'error', None)
    assert bench.land()[1].code == Land.Result.OK


def test_a_goal_that_cannot_begin_is_answered(
        bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Any:
        raise KeyError('ppo_agent_node')  # as ament_index does without the package

    monkeypatch.setattr(serving, 'Execution', fail)
    status, result = bench.land()
    assert (status, result.code) == (GoalStatus.STATUS_ABORTED, Land.Result.INVALID)
    assert not bench.actions.busy


def test_a_server_that_stops_waits_until_results_are_asked_for_but_not_for_ever(
        bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deferred_action_server, '_PATIENCE', 1.5)
    bench.land()

    def waited() -> float:
        begin = time.monotonic()
        deferred_action_server.deliver_results(
            bench.actions._servers.values(), bench.executor)
        return time.monotonic() - begin

    assert waited() < 1.0
    assert waited() < 0.1
    sent = bench.client.send_goal_async(Land.Goal())
    bench.wait(sent.done)
    bench.wait(lambda: not bench.actions.busy)
    assert waited() >= 1.5
    asked = sent.result().get_result_async()
    bench.wait(asked.done)
    assert waited() < 1.0


def test_a_goal_that_comes_while_the_server_stops_is_answered(
        bench: Bench, made: list[Execution], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, 'requested', lambda: True)
    status, result = bench.land()
    assert (status, result.code) == (GoalStatus.STATUS_ABORTED, Land.Result.FAILED)
    assert result.message == 'the server was stopped'
    assert not made


def test_closing_kills_the_processes_of_a_goal(
        bench: Bench, made: list[Execution], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.actions, 'poll', lambda: None)
    asked = bench.begin()
    assert bench.actions.busy
    bench.actions.close(bench.executor)
    assert asked.result().status == GoalStatus.STATUS_ABORTED
    assert asked.result().result.code == Land.Result.FAILED
    assert made[0].killed
    assert not made[0].scratch.exists()
    bench.wait(lambda: not bench.client.server_is_ready())
