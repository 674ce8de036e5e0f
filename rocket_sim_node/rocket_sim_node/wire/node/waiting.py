# SPDX-License-Identifier: Apache-2.0
"""Waiting for a peer: with a time-out, periodic log messages and no nested spinning."""
from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from collections.abc import Sequence
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node import ros_environment
from rocket_sim_node.errors import EnvironmentClosed
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.wire.node.polling import PollingWaitSet

_NOTICE_PERIOD = 5.0
"""Seconds between log messages while there is no answer."""
_LATE = 1.0
"""A check later than planned by this much, s, means that this process was suspended."""
_GRACE = 5.0
"""Minimum time, s, that a peer then has left to answer."""
_SIGNAL_PERIOD = 0.2
"""Seconds between checks for a stop request."""


class WireTimeout(TimeoutError):
    """The peer did not answer in time."""


class Waiter:
    """Spins an executor in the calling thread until a condition holds or a time-out."""

    def __init__(self, node: Node, executor: Executor, patience: float) -> None:
        """Wait with `executor`, which serves `node`, for at most `patience` s."""
        self._node = node
        self._executor = executor
        self._wait_set = PollingWaitSet(node, executor)
        self.patience = patience

    def spin(self, seconds: float) -> None:
        """Serve callbacks until one was served, the time is over or 0.2 s have passed.

        :raises EnvironmentClosed: when this process was asked to stop.
        """
        self._go_on()
        # Python handles signals only between two waits of the executor.
        self._executor.spin_once(timeout_sec=min(max(seconds, 0.0), _SIGNAL_PERIOD))

    def attend(
        self, seconds: float, polled: Sequence[ArraySubscription], **entities: Sequence[Any],
    ) -> tuple[list[ArraySubscription], bool]:
        """Wait for a message of a subscription or for other entities; see `PollingWaitSet.wait`.

        :raises EnvironmentClosed: when this process was asked to stop.
        """
        self._go_on()
        return self._wait_set.wait(polled, min(seconds, _SIGNAL_PERIOD), **entities)

    @property
    def overdue(self) -> bool:
        """Whether the node's callbacks and pending signals must be served now, with `attend`."""
        return self._wait_set.overdue

    def _go_on(self) -> None:
        if stopping.requested() or not self._node.context.ok():
            raise EnvironmentClosed('asked to stop')

    def linger(self, done: Callable[[], bool], seconds: float) -> None:
        """Spin until `done()` or the time is over, regardless of stop requests."""
        end = time.monotonic() + seconds
        while self._node.context.ok() and not done() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)

    def until(
        self, done: Callable[[], bool], seconds: float, **entities: Sequence[Any],
    ) -> bool:
        """Spin until `done()`; return false if the time is over first.

        :param entities: to wait for that the executor does not serve; see `PollingWaitSet.wait`.
        """
        end = time.monotonic() + seconds
        while not done():
            left = end - time.monotonic()
            if left <= 0:
                return False
            if entities:
                self.attend(left, [], **entities)
            else:
                self.spin(left)
        return True

    def wait(
        self, done: Callable[[], bool], what: str, topic: str = '', **entities: Sequence[Any],
    ) -> None:
        """Spin until `done()`.

        :param what: what is awaited, for log messages.
        :param topic: where the simulator describes itself; by default in the node's namespace.
        :param entities: as in `until`.
        :raises WireTimeout: when the patience runs out.
        """
        silence = Silence(self._node, what, self.patience, topic)
        while True:
            seconds = min(_NOTICE_PERIOD, silence.left)
            planned = time.monotonic() + seconds
            if self.until(done, seconds, **entities):
                return
            silence.check(planned)


class Silence:
    """A wait for an answer: logs a notice every few seconds and finally raises an error."""

    def __init__(
        self, node: Node, what: str, patience: float, topic: str = '',
        hint: Callable[[], str] = lambda: '',
    ) -> None:
        """Start to wait for `what` from the simulator that describes itself on `topic`.

        :param hint: returns a sentence on what may be wrong, or nothing.
        """
        self._node, self._hint = node, hint
        self._what = what
        self._topic = topic
        self._start = time.monotonic()
        self._end = self._start + patience
        self._notice = self._start + _NOTICE_PERIOD

    @property
    def left(self) -> float:
        """Time until the time-out, s."""
        return max(self._end - time.monotonic(), 0.0)

    @property
    def due(self) -> float:
        """Steady-clock time, s, of the next notice or error of `check`."""
        return min(self._notice, self._end)

    def check(self, planned: float = math.inf) -> None:
        """Log how long the wait has lasted, when that is due.

        :param planned: steady-clock time, s, when this check was due.
        :raises WireTimeout: when the patience runs out.
        """
        now = time.monotonic()
        if now > planned + _LATE:
            # The whole machine may have been suspended, so that the peer could not answer.
            self._end = max(self._end, now + _GRACE)
        if now < self.due:
            return
        topic = self._topic or self._node.resolve_topic_name('world')
        pattern = bool(set('*?[') & set(topic))
        waited = now - self._start
        text = (
            f'waited {waited:.{0 if waited >= 1 else 1}f} s for {self._what} from '
            f'the simulator{"s" if pattern else ""} of {topic}; '
            f'{ros_environment.advice(os.environ, several=pattern)}'
        )
        if not pattern and (simulators := self._node.count_publishers(topic)) > 1:
            text += f'; {simulators} publish there: give each simulator a namespace of its own'
        if hint := self._hint():
            text += f'; {hint}'
        if now >= self._end:
            raise WireTimeout(text)
        self._node.get_logger().warning(text)
        self._notice = now + _NOTICE_PERIOD
