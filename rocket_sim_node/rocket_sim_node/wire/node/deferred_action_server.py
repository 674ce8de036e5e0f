# SPDX-License-Identifier: Apache-2.0
"""An action server whose goals are finished by the program, not by a callback that waits."""
from __future__ import annotations

import math
import time
from collections.abc import Callable
from collections.abc import Collection
from typing import Any

from rclpy.action import ActionServer
from rclpy.action import CancelResponse
from rclpy.executors import Executor
from rclpy.node import Node

_DELIVERY = 0.2
"""Seconds that are allowed for the delivery of a result."""
_PATIENCE = 2.0
"""Most seconds for which a server that stops waits until its results have been asked for."""
_SPINS = 16
"""Callbacks that are served at least while a server stops, of those that are due already."""


class DeferredActionServer(ActionServer):
    """An action server whose goals last until `finish` is called.

    rclpy expects a callback that returns the result. If it is a coroutine that awaits a future,
    `EventsExecutor.spin_once` (rclpy 7.1.6 and 9.1.2) resumes it and returns at once, so a loop
    of `spin_once` keeps a core busy.
    """

    def __init__(
        self, node: Node, kind: type, name: str, begin: Callable[[Any], None], **options: Any,
    ) -> None:
        """Offer the action; every request to cancel a goal is accepted.

        :param kind: type of the action.
        :param begin: called with the handle of each goal, which is being executed or cancelled.
        :param options: further arguments of `rclpy.action.ActionServer`.
        """
        super().__init__(
            node, kind, name, begin, cancel_callback=lambda _: CancelResponse.ACCEPT, **options)
        self._begun: dict[bytes, bool] = {}
        """Goals that have not ended, each with whether a client has asked for its result."""
        self._unasked: set[bytes] = set()
        """Goals that have ended, and whose result no client has asked for."""
        self.changed = -math.inf
        """Time at which a goal last ended or its result was last asked for."""

    @property
    def has_unasked_result(self) -> bool:
        """Whether no client has asked yet for the result of a goal that has ended."""
        return bool(self._unasked)

    async def execute(self, taken_data: Any) -> None:
        """Handle a client's request; called by rclpy."""
        await super().execute(taken_data)
        if 'result' in taken_data:
            goal = bytes(taken_data['result'][1].goal_id.uuid)
            if goal in self._begun:
                self._begun[goal] = True
            self._unasked.discard(goal)
            self.changed = time.monotonic()
        for expired in taken_data.get('expired', ()):
            self._unasked.discard(bytes(expired.goal_id.uuid))

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Begin a goal; called by rclpy."""
        self._begun[bytes(goal_handle.goal_id.uuid)] = False
        (execute_callback or self._execute_callback)(goal_handle)

    def finish(self, goal_handle: Any, result: Any) -> None:
        """Send the result of a goal, whose final state must have been set."""
        goal = bytes(goal_handle.goal_id.uuid)
        if not self._begun.pop(goal):
            self._unasked.add(goal)
        super().notify_execute(goal_handle, lambda _: result)
        self.changed = time.monotonic()


def deliver_results(servers: Collection[DeferredActionServer], executor: Executor) -> None:
    """Serve until the clients have all results, before the servers are destroyed.

    A client may ask for a result after the goal has ended. For one that never asks, it serves two
    seconds.
    """
    end, changed, spins = time.monotonic() + _PATIENCE, -math.inf, 0
    while (now := time.monotonic()) < end:
        newest = max(server.changed for server in servers)
        if newest > changed:
            changed, spins = newest, 0
        waiting = now < changed + _DELIVERY or any(server.has_unasked_result for server in servers)
        if not waiting and spins >= _SPINS:
            return
        executor.spin_once(timeout_sec=0.02 if waiting else 0.0)
        spins += 1
