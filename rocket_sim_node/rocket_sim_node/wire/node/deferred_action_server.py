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
"""Seconds after which a result that was sent has been delivered."""
_PATIENCE = 2.0
"""Most seconds for which a server that stops waits for the clients of its goals."""


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
        self._asked: set[bytes] = set()
        self._unasked: set[bytes] = set()
        """goals whose result a client has asked for, and those that ended before it did"""
        self._sent = -math.inf
        """time of the newest result"""

    @property
    def delivered(self) -> bool:
        """Whether clients have asked for all results, and received them."""
        return not self._unasked and time.monotonic() > self._sent + _DELIVERY

    async def execute(self, taken_data: Any) -> None:
        """Handle a client's request; called by rclpy."""
        await super().execute(taken_data)
        if 'result' in taken_data:
            goal = bytes(taken_data['result'][1].goal_id.uuid)
            self._asked.add(goal)
            if goal in self._unasked:
                self._unasked.remove(goal)
                self._sent = time.monotonic()
        for expired in taken_data.get('expired', ()):
            self._asked.discard(bytes(expired.goal_id.uuid))
            self._unasked.discard(bytes(expired.goal_id.uuid))

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Begin a goal; called by rclpy."""
        (execute_callback or self._execute_callback)(goal_handle)

    def finish(self, goal_handle: Any, result: Any) -> None:
        """Send the result of a goal, whose final state must have been set."""
        super().notify_execute(goal_handle, lambda _: result)
        goal = bytes(goal_handle.goal_id.uuid)
        if goal not in self._asked:
            self._unasked.add(goal)
        self._sent = time.monotonic()


def deliver_results(servers: Collection[DeferredActionServer], executor: Executor) -> None:
    """Serve until the clients have the results, before the servers are destroyed.

    The request for a result may arrive after the goal has ended. Clients that never ask for it
    are waited for during two seconds.
    """
    end = time.monotonic() + _PATIENCE
    while not all(server.delivered for server in servers) and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
