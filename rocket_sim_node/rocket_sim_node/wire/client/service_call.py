# SPDX-License-Identifier: Apache-2.0
"""A call of a service that is made anew until it is answered; nothing here waits."""
from __future__ import annotations

from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from rocket_sim_node.wire.node.waiting import Silence

_TIMEOUT, _LONGEST = 0.25, 10.0
"""s after which a call is made anew; doubled each time, up to this, as it may just take long"""
_READY_PERIOD = 0.05
"""s between two looks at whether the service is there"""


class ServiceCall:
    """One request to one service: `poll` it until the response is there."""

    def __init__(
        self, node: Node, client: Client, request: Any, patience: float, topic: str, begin: float,
    ) -> None:
        """Prepare; nothing is sent yet.

        :param patience: s without a response after which none is expected any more.
        :param topic: on which the far end describes itself, for what is said when it is silent.
        :param begin: when to call first, s of the steady clock.
        """
        self._client, self._request = client, request
        self._silence = Silence(node, f'an answer of {client.srv_name}', patience, topic)
        self._timeout = _TIMEOUT
        self._future: Future[Any] | None = None
        self._again = begin
        self.due = begin
        """when `poll` wants to be called at the latest, s of the steady clock"""
        self.made = False
        """whether anything was sent"""

    def poll(self, now: float) -> Any:
        """Call when the service is there, again when it does not answer; return the response.

        It is None before it has come.

        :raises WireTimeout: when there was none for too long.
        """
        if self._future is not None and self._future.done():
            response, self._future = self._future.result(), None
            return response
        if now < self.due:
            return None
        self._silence.check(self.due)
        if now >= self._again:
            self._call_anew(now)
        # No later than to say how long it has been, or that patience is over.
        self.due = min(self._again, self._silence.due)
        return None

    def _call_anew(self, now: float) -> None:
        self.drop()
        self._again = now + _READY_PERIOD
        if self._client.service_is_ready():
            self._future = self._client.call_async(self._request)
            self.made = True
            self._again = now + self._timeout
            self._timeout = min(2 * self._timeout, _LONGEST)

    def drop(self) -> None:
        """Expect no response any more."""
        if self._future is not None:
            self._client.remove_pending_request(self._future)
            self._future = None
