# SPDX-License-Identifier: Apache-2.0
"""Service of the actions: one goal at a time, with feedback, until its end or its cancellation."""
from __future__ import annotations

import math
import time
from contextlib import ExitStack
from functools import partial
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs.msg import Episodes
from rocket_msgs.msg import TrainingStatus

from ppo_agent_node.nodes.actions.execution import KINDS
from ppo_agent_node.nodes.actions.execution import Execution
from ppo_agent_node.nodes.actions.flight_figures import no_figures
from ppo_agent_node.nodes.agent.status_message import status_from_message
from ppo_agent_node.terminal import formatting
from rocket_sim_node.scratch_folder import scratch_folder
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.deferred_action_server import DeferredActionServer
from rocket_sim_node.wire.node.deferred_action_server import deliver_results

_KEEP = 900
"""Seconds for which the server keeps a result, as in rclcpp."""
_FEEDBACK_PERIOD = 0.5
"""Least time in s between two feedbacks on flights, of which hundreds may end in a second."""
_DRAIN = 0.2
"""Seconds after the end of the processes in which their last messages are received."""
_STOPPED = 'the server was stopped'
_ERRORS = (ValueError, TypeError, KeyError, OSError)
"""raised for goals, and for files of a run, that are invalid"""


class Actions:
    """The action servers; `poll` has to be called often while a goal is being executed."""

    def __init__(self, node: Node) -> None:
        """Start serving."""
        self._node = node
        self._execution: Execution | None = None
        self._handle: Any = None
        """of the goal that is being executed"""
        self._scratch = ExitStack()
        """kills the processes of that goal and removes its temporary folder"""
        self._running_until = self._told = -math.inf
        self._closing = False
        self._untold = False
        """whether flights have ended since the last feedback"""
        self._servers = {
            name: DeferredActionServer(
                node, kind, name, partial(self._begin, name), result_timeout=_KEEP)
            for name, kind in KINDS.items()}
        node.create_subscription(
            TrainingStatus, 'train/training', self._on_training, qos.EVENTS)
        for name in ('evaluate', 'land'):
            node.create_subscription(
                Episodes, f'{name}/episodes', partial(self._on_episodes, name), qos.EVENTS)

    @property
    def busy(self) -> bool:
        """Whether a goal is being executed."""
        return self._execution is not None

    def poll(self) -> None:
        """Stop the processes of the goal when asked to, and send its result after their end."""
        if self._execution is None:
            return
        self._tell()
        if self._stopped:
            self._execution.process.interrupt()
        if not self._execution.process.ended:
            self._running_until = time.monotonic()
        elif time.monotonic() > self._running_until + _DRAIN:
            self._told = -math.inf
            self._tell()
            self._finish(self._execution)

    def close(self, executor: Executor) -> None:
        """Kill the processes of a goal that has not ended, and remove the servers from DDS.

        :param executor: the node's, which sends the results of goals that have ended.
        """
        self._closing = True
        try:
            if self._execution is not None:
                self._abandon(self._execution)
            deliver_results(self._servers.values(), executor)
        finally:
            for server in self._servers.values():  # destroying the node does not
                server.destroy()

    def _abandon(self, execution: Execution) -> None:
        """Kill the processes of a goal and abort it."""
        name = execution.command
        self._execution = None
        with self._scratch:
            self._abort(name, self._handle, KINDS[name].Result.FAILED, _STOPPED)

    def _abort(self, name: str, handle: Any, code: int, why: str) -> None:
        """Abort a goal without figures."""
        handle.abort()
        self._servers[name].finish(
            handle, KINDS[name].Result(code=code, figures=no_figures(), message=why))

    @property
    def _stopped(self) -> str:
        """Why the goal has to be stopped; empty: it has not."""
        if self._handle.is_cancel_requested:
            return 'cancelled'
        return _STOPPED if stopping.requested() else ''

    def _begin(self, name: str, handle: Any) -> None:
        """Start the processes of a goal, or send at once why that cannot be."""
        kind = KINDS[name].Result
        # A rejection could not say why: a goal that cannot be executed is accepted and aborted.
        if self._execution is not None:
            code, why = kind.BUSY, (
                f'{self._execution.command}: a goal of it is being executed, expected none; wait '
                'for its result or cancel it')
        elif self._closing or stopping.requested():
            code, why = kind.FAILED, _STOPPED
        else:
            try:
                self._execution = execution = Execution(
                    name, handle.request, self._node.get_namespace(),
                    self._scratch.enter_context(scratch_folder()))
                self._scratch.callback(execution.process.kill)
            except _ERRORS as error:
                self._scratch.close()
                code, why = kind.INVALID, ' '.join(str(error).split())
            else:
                self._handle, self._untold = handle, False
                self._running_until = time.monotonic()
                self._node.get_logger().info(f'{name}: started')
                return
        self._abort(name, handle, code, why)

    def _finish(self, execution: Execution) -> None:
        """Send the result of the goal, whose processes have ended."""
        name, handle = execution.command, self._handle
        kind = KINDS[name].Result
        try:
            with self._scratch:
                result = execution.result(self._stopped)
        except _ERRORS as error:
            # A result that was not set would read as OK.
            result = kind(code=kind.FAILED, figures=no_figures(), message=(
                f'{name}: the figures cannot be read: {" ".join(str(error).split())}'))
        self._execution = None
        if result.code == kind.OK:
            handle.succeed()
        elif handle.is_cancel_requested:
            result.code = kind.CANCELED
            handle.canceled()
        else:
            handle.abort()
        self._node.get_logger().info(f'{name}: {result.message or "done"}')
        self._servers[name].finish(handle, result)

    def _on_training(self, message: TrainingStatus) -> None:
        if self._execution is not None and self._execution.command == 'train':
            self._handle.publish_feedback(KINDS['train'].Feedback(
                status=message, text=formatting.line(status_from_message(message))))

    def _on_episodes(self, name: str, message: Episodes) -> None:
        if self._execution is None or self._execution.command != name:
            return
        self._execution.statistics.add(message)
        self._untold = True
        self._tell()

    def _tell(self) -> None:
        """Publish the newest figures of flights as feedback, but not too often."""
        if (self._execution is None or not self._untold
                or time.monotonic() < self._told + _FEEDBACK_PERIOD):
            return
        self._told, self._untold = time.monotonic(), False
        statistics = self._execution.statistics
        self._handle.publish_feedback(KINDS[self._execution.command].Feedback(
            figures=statistics.figures(), text=statistics.text()))
