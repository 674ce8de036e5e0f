# SPDX-License-Identifier: Apache-2.0
"""A service call that is repeated until it is answered, without blocking."""
from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.node import Node

from rocket_sim_node.wire.node.polling import PolledClient
from rocket_sim_node.wire.node.waiting import Silence

_TIMEOUT, _LONGEST = 0.25, 10.0
"""Seconds before a call is repeated; doubled each time up to the second value, because a call may
simply take long."""
_READY_PERIOD = 0.05
"""Seconds between checks for whether the service is available."""


class ServiceCall:
    """One request to one service: `poll` until an answer of the right server has arrived."""

    def __init__(
        self, node: Node, client: PolledClient, request: Any, patience: float, topic: str,
        begin: float,
    ) -> None:
        """Prepare the call; nothing is sent yet.

        :param patience: seconds without a response before giving up.
        :param topic: topic that describes the peer, for messages about its silence.
        :param begin: steady-clock time, s, of the first call.
        """
        self.client, self._request = client, request
        self._silence = Silence(
            node, f'an answer of {client.srv_name}', patience, topic, self._hint)
        self._described = partial(node.count_publishers, topic)
        self._timeout = _TIMEOUT
        self._number = 0
        """Number of the latest request; 0 before the first."""
        self.answers: list[Any] = []
        """All answers to the latest request, of whatever server."""
        self.doubled = 0
        """Answers to the request before this call, which had been answered already."""
        self._again = begin
        self.due = begin
        """Steady-clock time, s, by which `poll` must be called."""
        self.made = False
        """Whether anything was sent."""

    def poll(self, now: float) -> list[Any]:
        """Call once the service is available, repeat if it does not answer; return the answers.

        :raises WireTimeout: when there was none for too long.
        """
        fresh = False
        while (taken := self.client.take()) is not None:
            number, answer = taken
            if number == self._number:
                self.answers.append(answer)
                fresh = True
            elif number == self.client.settled:
                self.doubled += 1
        if now < self.due or fresh:
            return self.answers
        self._silence.check(self.due)
        if now >= self._again:
            self._call_anew(now)
        # In time for the next notice or the time-out.
        self.due = min(self._again, self._silence.due)
        return self.answers

    def _hint(self) -> str:
        """Return what to do where a simulator of another name describes itself."""
        if self.client.service_is_ready() or not self._described():
            return ''
        name = self.client.srv_name
        head, _, service = name.rpartition('/')
        other = f'{head.rpartition("/")[0]}/NAME/{service}'
        return (f'no node offers {name}; if the simulator has another name, remap the service: '
                f'--ros-args -r {name}:={other}')

    def settle(self) -> None:
        """Note that the latest request is answered: further answers come from another server."""
        self.client.settled = self._number

    def _call_anew(self, now: float) -> None:
        self._again = now + _READY_PERIOD
        if self.client.service_is_ready():
            # Answers to an abandoned request are ignored from now on.
            self._number, self.answers = self.client.send(self._request), []
            self.made = True
            self._again = now + self._timeout
            self._timeout = min(2 * self._timeout, _LONGEST)
