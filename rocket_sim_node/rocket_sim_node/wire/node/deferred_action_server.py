# SPDX-License-Identifier: Apache-2.0
"""An action server whose goals are finished by the program, not by a callback that waits."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer
from rclpy.action import CancelResponse
from rclpy.node import Node


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

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Begin a goal; called by rclpy."""
        (execute_callback or self._execute_callback)(goal_handle)

    def finish(self, goal_handle: Any, result: Any) -> None:
        """Send the result of a goal, whose final state must have been set."""
        super().notify_execute(goal_handle, lambda _: result)
