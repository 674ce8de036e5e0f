# SPDX-License-Identifier: Apache-2.0
"""Action SimulateSteps of simulation_interfaces: steps with feedback, which can be cancelled."""
from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result

from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.deferred_action_server import DeferredActionServer
from rocket_sim_node.wire.node.deferred_action_server import deliver_results
from rocket_sim_node.wire.node.steady_clock import create_timer
from rocket_sim_node.wire.server.server import Server

_SLICE = 0.01
"""Seconds of steps at a time, so that the node can serve others, followed by a feedback: a client
cannot keep up with one for each step."""
_PERIOD = 0.02
"""Seconds between two such slices."""
_STOPPING = 'the simulator is stopping'


class SimulateStepsServer:
    """Executes one goal at a time; an agent that takes control ends it."""

    def __init__(self, node: Node, server: Server, refusal: Callable[[], tuple[int, str]]) -> None:
        """Offer the action.

        :param refusal: returns code and reason why there can be no steps now; RESULT_OK if they
            can be.
        """
        self._server, self._refusal = server, refusal
        self._goal: Any = None
        """that is being executed"""
        self._done, self._session = 0, 0
        self._closing = False
        self._timer = create_timer(node, _PERIOD, self._fly)
        self._timer.cancel()  # it runs while there is a goal
        self._action = DeferredActionServer(
            node, SimulateSteps, '~/simulate_steps', self._begin)

    @property
    def active(self) -> bool:
        """Whether a goal is being executed."""
        return self._goal is not None

    def destroy(self, executor: Executor) -> None:
        """Abort the goal, and remove the action from DDS; destroying the node does not.

        :param executor: the node's, which sends the result.
        """
        self._closing = True
        try:
            if self.active:
                self._end(_STOPPING)
            deliver_results((self._action,), executor)
        finally:
            self._action.destroy()

    def _begin(self, goal: Any) -> None:
        """Take the goal on, or send why not."""
        code, why = self._refusal()
        if self._closing or stopping.requested():
            code, why = Result.RESULT_OPERATION_FAILED, _STOPPING
        if code != Result.RESULT_OK:
            self._finish(goal, code, why)
            return
        self._server.idle_stepper.step(0)  # takes control from an agent whose lease expired
        self._goal, self._done, self._session = goal, 0, self._server.present[0]
        self._timer.reset()

    def _finish(self, goal: Any, code: int, why: str) -> None:
        """End a goal and send its result."""
        if code == Result.RESULT_OK:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        result = SimulateSteps.Result()
        result.result.result, result.result.error_message = code, why
        self._action.finish(goal, result)

    def _fly(self) -> None:
        """Fly a slice of the goal, if there is one, and end it when its steps are flown."""
        if self._goal is None:  # a tick that was due when the goal ended
            return
        goal, stepper = self._goal, self._server.idle_stepper
        steps, until = goal.request.steps, time.monotonic() + _SLICE
        why = ''
        while not why and self._done < steps and time.monotonic() < until:
            if goal.is_cancel_requested:
                why = 'cancelled'
            elif self._server.present[0] != self._session:
                why = stepper.flown_by() or 'an agent took control'
            elif not stepper.step(1):
                why = _STOPPING
            else:
                self._done += 1
        goal.publish_feedback(SimulateSteps.Feedback(
            completed_steps=self._done, remaining_steps=steps - self._done))
        if why or self._done == steps:
            self._end(why)

    def _end(self, why: str) -> None:
        """End the goal that is being executed.

        :param why: it ends early; empty: its steps are flown.
        """
        goal, self._goal = self._goal, None
        self._timer.cancel()
        if why:
            self._finish(goal, Result.RESULT_OPERATION_FAILED,
                         f'{why}; {self._done} of {goal.request.steps} steps were flown')
        else:
            self._finish(goal, Result.RESULT_OK, '')
