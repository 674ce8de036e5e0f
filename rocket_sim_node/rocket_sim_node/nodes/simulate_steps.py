# SPDX-License-Identifier: Apache-2.0
"""Action SimulateSteps of simulation_interfaces: steps with feedback, which can be cancelled."""
from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.action import ActionServer
from rclpy.action import CancelResponse
from rclpy.node import Node
from rclpy.task import Future
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result

from rocket_sim_node.wire.node.steady_clock import create_timer
from rocket_sim_node.wire.server.server import Server

_SLICE = 0.01
"""Seconds of steps at a time, so that the node can serve others, followed by a feedback: a client
cannot keep up with one for each step."""
_PERIOD = 0.02
"""Seconds between two such slices."""


class SimulateStepsServer:
    """Executes one goal at a time; an agent that takes control ends it."""

    def __init__(self, node: Node, server: Server, refusal: Callable[[], tuple[int, str]]) -> None:
        """Offer the action.

        :param refusal: returns code and reason why there can be no steps now; RESULT_OK if they
            can be.
        """
        self._server, self._refusal = server, refusal
        self._goal: Any = None
        self._done, self._session = 0, 0
        self._ended: Future | None = None
        self._timer = create_timer(node, _PERIOD, self._fly)
        self._timer.cancel()  # it runs while there is a goal
        # An execute_callback is required, but each goal names its own when it begins.
        self._action = ActionServer(
            node, SimulateSteps, '~/simulate_steps', execute_callback=lambda _: None,
            handle_accepted_callback=self._begin,
            cancel_callback=lambda _: CancelResponse.ACCEPT)

    @property
    def active(self) -> bool:
        """Whether a goal is being executed."""
        return self._ended is not None

    def destroy(self) -> None:
        """Remove it from DDS; destroying the node does not."""
        self._action.destroy()

    def _begin(self, goal: Any) -> None:
        """Take the goal on, or note why not, before the node serves any other call."""
        code, why = self._refusal()
        ended = Future()
        if code == Result.RESULT_OK:
            self._server.idle_stepper.step(0)  # takes control from an agent whose lease expired
            self._goal, self._done, self._session = goal, 0, self._server.present[0]
            self._ended = ended
            self._timer.reset()
        else:
            ended.set_result((code, why))
        goal.execute(partial(self._execute, ended))

    @staticmethod
    async def _execute(ended: Future, goal: Any) -> Any:
        code, why = await ended
        if code == Result.RESULT_OK:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        result = SimulateSteps.Result()
        result.result.result, result.result.error_message = code, why
        return result

    def _fly(self) -> None:
        """Fly a slice of the goal, if there is one, and end it when its steps are flown."""
        if self._ended is None:  # a tick that was due when the goal ended
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
                why = 'the simulator is stopping'
            else:
                self._done += 1
        goal.publish_feedback(SimulateSteps.Feedback(
            completed_steps=self._done, remaining_steps=steps - self._done))
        if why or self._done == steps:
            self._timer.cancel()
            ended, self._ended = self._ended, None
            ended.set_result(
                (Result.RESULT_OPERATION_FAILED,
                 f'{why}; {self._done} of {steps} steps were flown') if why
                else (Result.RESULT_OK, ''))
