# SPDX-License-Identifier: Apache-2.0
"""Service of the actions: one goal at a time, with feedback, until its end or its cancellation."""
from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

from rclpy.action import ActionServer
from rclpy.action import CancelResponse
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future
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

_KEEP = 900
"""Seconds for which the server keeps a result, as in rclcpp."""
_FEEDBACK_PERIOD = 0.5
"""Least time in s between two feedbacks on flights, of which hundreds may end in a second."""
_DRAIN = 0.2
"""Seconds after the end of the processes in which their last messages are received."""


class Actions:
    """The action servers; `poll` has to be called often while a goal is being executed."""

    def __init__(self, node: Node, executor: Executor) -> None:
        """Start serving."""
        self._node, self._executor = node, executor
        self._execution: Execution | None = None
        self._handle: Any = None
        """of the goal that is being executed"""
        self._ended: Any = None
        """Future: the processes of that goal have ended"""
        self._running_until = self._told = -math.inf
        self._untold = False
        """whether flights have ended since the last feedback"""
        for name, kind in KINDS.items():
            ActionServer(
                node, kind, name, partial(self._execute, name),
                cancel_callback=lambda _: CancelResponse.ACCEPT, result_timeout=_KEEP)
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
        """Stop the processes of the goal when asked to, and note their end."""
        if self._execution is None:
            return
        self._tell()
        if self._stopped:
            self._execution.process.interrupt()
        if not self._execution.process.ended:
            self._running_until = time.monotonic()
        elif time.monotonic() > self._running_until + _DRAIN and not self._ended.done():
            self._told = -math.inf
            self._tell()
            self._ended.set_result(None)

    @property
    def _stopped(self) -> str:
        """Why the goal has to be stopped; empty: it has not."""
        if self._handle.is_cancel_requested:
            return 'cancelled'
        return 'the server was stopped' if stopping.requested() else ''

    async def _execute(self, name: str, handle: Any) -> Any:
        """Execute a goal; return its result."""
        kind, log = KINDS[name].Result, self._node.get_logger()
        # A rejection could not say why: a goal that cannot be executed is accepted and aborted.
        if self._execution is not None:
            handle.abort()
            return kind(code=kind.BUSY, figures=no_figures(), message=(
                f'{self._execution.command}: a goal of it is being executed, expected none; wait '
                'for its result or cancel it'))
        with scratch_folder() as scratch:
            try:
                self._execution = execution = Execution(
                    name, handle.request, self._node.get_namespace(), scratch)
            except (ValueError, TypeError, OSError) as error:
                handle.abort()
                return kind(code=kind.INVALID, figures=no_figures(),
                            message=' '.join(str(error).split()))
            self._handle, self._ended = handle, Future(executor=self._executor)
            self._untold = False
            try:
                log.info(f'{name}: started')
                await self._ended
                result = execution.result(self._stopped)
            except (ValueError, TypeError, KeyError, OSError) as error:
                # A result that was not set would read as OK.
                result = kind(code=kind.FAILED, figures=no_figures(), message=(
                    f'{name}: the figures cannot be read: {" ".join(str(error).split())}'))
            finally:
                execution.process.kill()
                self._execution = None
        if result.code == kind.OK:
            handle.succeed()
        elif handle.is_cancel_requested:
            result.code = kind.CANCELED
            handle.canceled()
        else:
            handle.abort()
        log.info(f'{name}: {result.message or "done"}')
        return result

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
