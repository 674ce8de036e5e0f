# SPDX-License-Identifier: Apache-2.0
"""Waiting for the far end: bounded, with a word now and then, and without nested spinning."""
from __future__ import annotations

import math
import time
from collections.abc import Callable
from collections.abc import Sequence
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.errors import EnvironmentClosed
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.inbox import Inbox
from rocket_sim_node.wire.node.inbox import Mailbox

_NOTICE_PERIOD = 5.0
"""s between log lines while there is no answer"""
_LATE = 1.0
"""s by which a look at a silence comes later than planned when this process has stood still"""
_GRACE = 5.0
"""s that there are for an answer after that, at least"""
_SIGNAL_PERIOD = 0.2
"""s between two looks at whether this process was asked to end"""


class WireTimeout(TimeoutError):
    """The far end did not answer within the patience."""


class Waiter:
    """Spins an executor in the calling thread until something has come, or patience is over."""

    def __init__(self, node: Node, executor: Executor, patience: float) -> None:
        """Wait with `executor`, which serves `node`, for `patience` s at most."""
        self._node = node
        self._executor = executor
        self._inbox = Inbox(node, executor)
        self.patience = patience

    def spin(self, seconds: float) -> None:
        """Serve callbacks until one was served, the time is over or 0.2 s have passed.

        :raises EnvironmentClosed: when this process was asked to end.
        """
        self._go_on()
        # Python sees a signal only between two waits of the executor.
        self._executor.spin_once(timeout_sec=min(max(seconds, 0.0), _SIGNAL_PERIOD))

    def attend(
        self, seconds: float, mailboxes: Sequence[Mailbox], **entities: Sequence[Any],
    ) -> tuple[list[Mailbox], bool]:
        """Return when a mailbox has a message or something else was served; see `Inbox.wait`.

        :raises EnvironmentClosed: when this process was asked to end.
        """
        self._go_on()
        return self._inbox.wait(mailboxes, min(seconds, _SIGNAL_PERIOD), **entities)

    @property
    def overdue(self) -> bool:
        """Whether the node wants to be served, and this process to see signals: now `attend`."""
        return self._inbox.overdue

    def _go_on(self) -> None:
        if stopping.requested() or not self._node.context.ok():
            raise EnvironmentClosed('asked to stop')

    def linger(self, done: Callable[[], bool], seconds: float) -> None:
        """Spin until `done()` or the time is over, asked to end or not."""
        end = time.monotonic() + seconds
        while self._node.context.ok() and not done() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)

    def until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Spin until `done()`; false when the time was over first."""
        end = time.monotonic() + seconds
        while not done():
            left = end - time.monotonic()
            if left <= 0:
                return False
            self.spin(left)
        return True

    def wait(self, done: Callable[[], bool], what: str, topic: str = '') -> None:
        """Spin until `done()`.

        :param what: what is waited for, as the log shall say it.
        :param topic: where the simulator describes itself; by default in the node's namespace.
        :raises WireTimeout: when patience is over.
        """
        silence = Silence(self._node, what, self.patience, topic)
        while True:
            seconds = min(_NOTICE_PERIOD, silence.left)
            planned = time.monotonic() + seconds
            if self.until(done, seconds):
                return
            silence.check(planned)


class Silence:
    """Time without an answer: told on the log every few seconds, and at the end an error."""

    def __init__(self, node: Node, what: str, patience: float, topic: str = '') -> None:
        """Begin to wait for `what` from the simulator that describes itself on a topic."""
        self._node = node
        self._what = what
        self._topic = topic
        self._start = time.monotonic()
        self._end = self._start + patience
        self._notice = self._start + _NOTICE_PERIOD

    @property
    def left(self) -> float:
        """Patience left, s."""
        return max(self._end - time.monotonic(), 0.0)

    @property
    def due(self) -> float:
        """When `check` has something to say next, s of the steady clock."""
        return min(self._notice, self._end)

    def check(self, planned: float = math.inf) -> None:
        """Say how long it has been, when it is time to.

        :param planned: when this look was to be taken, s of the steady clock.
        :raises WireTimeout: when patience is over.
        """
        now = time.monotonic()
        if now > planned + _LATE:
            # Perhaps everybody stood still, and nobody could have answered.
            self._end = max(self._end, now + _GRACE)
        if now < self.due:
            return
        topic = self._topic or self._node.resolve_topic_name('world')
        text = (
            f'waited {now - self._start:.0f} s for {self._what} from the simulator of {topic}; '
            'is it running, with the same ROS_DOMAIN_ID and namespace?'
        )
        if not set('*?[') & set(topic) and (simulators := self._node.count_publishers(topic)) > 1:
            text += f' {simulators} publish there: give each simulator a namespace of its own'
        if now >= self._end:
            raise WireTimeout(text)
        self._node.get_logger().warning(text)
        self._notice = now + _NOTICE_PERIOD
