# SPDX-License-Identifier: Apache-2.0
"""Waiting for the far end: bounded, with a word now and then, and without nested spinning."""
from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.client import Client as ServiceClient
from rclpy.executors import Executor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from rocket_sim_node.worlds import EnvironmentClosed

_NOTICE_PERIOD = 5.0
"""s between log lines while there is no answer"""
_CALL_TIMEOUT = 2.0
"""s after which a service call is made anew"""


class WireTimeout(TimeoutError):
    """The far end did not answer within the patience."""


class Waiter:
    """Spins an executor in the calling thread until something has come, or patience is over."""

    def __init__(self, node: Node, executor: Executor, patience: float) -> None:
        """Wait with `executor`, which serves `node`, for `patience` s at most."""
        self._node = node
        self._executor = executor
        self.patience = patience

    def spin(self, seconds: float) -> None:
        """Serve callbacks until one was served or the time is over.

        :raises EnvironmentClosed: when ROS was shut down.
        """
        try:
            if self._node.context.ok():
                self._executor.spin_once(timeout_sec=max(seconds, 0.0))
                return
        except ExternalShutdownException:
            pass
        raise EnvironmentClosed('ROS was shut down')

    def until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Spin until `done()`; false when the time was over first."""
        end = time.monotonic() + seconds
        while not done():
            left = end - time.monotonic()
            if left <= 0:
                return False
            self.spin(min(left, 0.1))
        return True

    def wait(self, done: Callable[[], bool], what: str) -> None:
        """Spin until `done()`.

        :param what: what is waited for, as the log shall say it.
        :raises WireTimeout: when patience is over.
        """
        silence = Silence(self._node, what, self.patience)
        while not self.until(done, min(_NOTICE_PERIOD, silence.left)):
            silence.check()

    def call(self, client: ServiceClient, request: Any) -> Any:
        """Call a service, again when there is no answer, and return the answer.

        :raises WireTimeout: when patience is over.
        """
        silence = Silence(self._node, f'an answer of {client.srv_name}', self.patience)
        while True:
            if self.until(client.service_is_ready, _CALL_TIMEOUT):
                future = client.call_async(request)
                if self.until(future.done, _CALL_TIMEOUT):
                    return future.result()
                client.remove_pending_request(future)
            silence.check()


class Silence:
    """Time without an answer: told on the log every few seconds, and at the end an error."""

    def __init__(self, node: Node, what: str, patience: float) -> None:
        """Begin to wait for `what`."""
        self._node = node
        self._what = what
        self._start = time.monotonic()
        self._end = self._start + patience
        self._notice = self._start + _NOTICE_PERIOD

    @property
    def left(self) -> float:
        """Patience left, s."""
        return max(self._end - time.monotonic(), 0.0)

    def check(self) -> None:
        """Say how long it has been, when it is time to.

        :raises WireTimeout: when patience is over.
        """
        now = time.monotonic()
        if now < min(self._notice, self._end):
            return
        topic = self._node.resolve_topic_name('world')
        text = (
            f'waited {now - self._start:.0f} s for {self._what} from the simulator of {topic}; '
            'is it running, with the same ROS_DOMAIN_ID and namespace?'
        )
        if now >= self._end:
            raise WireTimeout(text)
        self._node.get_logger().warning(text)
        self._notice = now + _NOTICE_PERIOD
