# SPDX-License-Identifier: Apache-2.0
"""A service call that is repeated until it is answered, without blocking."""
from __future__ import annotations

from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from rocket_sim_node.wire.node.waiting import Silence

_TIMEOUT, _LONGEST = 0.25, 10.0
"""Seconds before a call is repeated; doubled each time up to the second value, because a call may
simply take long."""
_READY_PERIOD = 0.05
"""Seconds between checks for whether the service is available."""


class ServiceCall:
    """One request to one service: `poll` until the response has arrived."""

    def __init__(
        self, node: Node, client: Client, request: Any, patience: float, topic: str, begin: float,
    ) -> None:
        """Prepare the call; nothing is sent yet.

        :param patience: seconds without a response before giving up.
        :param topic: topic that describes the peer, for messages about its silence.
        :param begin: steady-clock time, s, of the first call.
        """
        self._client, self._request = client, request
        self._silence = Silence(node, f'an answer of {client.srv_name}', patience, topic)
        self._timeout = _TIMEOUT
        self._future: Future[Any] | None = None
        self._again = begin
        self.due = begin
        """Steady-clock time, s, by which `poll` must be called."""
        self.made = False
        """Whether anything was sent."""

    def poll(self, now: float) -> Any:
        """Call once the service is available, repeat if it does not answer; return the response.

        Returns None until the response has arrived.

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
        # In time for the next notice or the time-out.
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
        """Ignore any further response."""
        if self._future is not None:
            self._client.remove_pending_request(self._future)
            self._future = None
