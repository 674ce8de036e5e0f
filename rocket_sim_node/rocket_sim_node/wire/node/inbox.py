# SPDX-License-Identifier: Apache-2.0
"""Low-latency waiting for the messages of a step, bypassing the executor.

An executor rebuilds its list of entities for each message, or passes events between threads, and
converts messages to Python objects: that takes longer than the transfer through DDS. A lock-step
exchange waits for one topic of each peer only. Its topics therefore have subscriptions that are
not added to an executor and return bytes, and their own wait set, used as in
`rclpy.wait_for_message`. The node's executor serves everything else in between.

If messages arrive quickly, the inbox polls for a while before it sleeps in the wait set, and
yields its core in between. Falling asleep and waking up takes longer than most answers: a halted
core wakes slowly, with cold caches. DDS's own threads can preempt the polling at any time.
"""
from __future__ import annotations

import os
import time
import weakref
from collections.abc import Sequence
from typing import Any
from typing import ClassVar

from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.type_support import check_is_valid_msg_type

from rocket_sim_node.wire.messages.cdr import Codec

_SERVE_PERIOD = 0.05
"""Seconds between executor runs that serve the rest of the node."""
_LOOK_OUT = 0.0006
"""Seconds of polling before sleeping: longer than most answers of a simulator take. Polling longer
slows down other processes on a machine with two cores."""
_BRISK = 0.0008
"""Polling is used if the previous message arrived within this time, s."""
_CORES = len(os.sched_getaffinity(0))
_SERVED_AT_ONCE = 16
"""Maximum callbacks per run: `spin_once` serves one and does not report whether there was any."""


class Mailbox:
    """A subscription that is read by polling instead of callbacks.

    The node does not know it, so call `destroy_all` before the node is destroyed: a remaining
    subscription keeps the participant alive, and peers do not notice that it is gone.
    """

    _open: ClassVar[weakref.WeakSet[Mailbox]] = weakref.WeakSet()

    def __init__(self, node: Node, kind: Any, topic: str, profile: QoSProfile) -> None:
        """Subscribe, with the node's remapping and namespace."""
        check_is_valid_msg_type(kind)  # also loads the type's C support
        self._node, self._kind, self.topic = node, kind, topic
        self._codec = Codec(kind)
        with node.handle:
            self.handle = _rclpy.Subscription(
                node.handle, kind, topic, profile.get_c_qos_profile())
        self.held: Any = None
        """A message already taken from DDS; the wait set no longer reports it."""
        self._open.add(self)

    @property
    def full(self) -> bool:
        """Whether a message has arrived."""
        if self.held is None:
            self.held = self._fetch()
        return self.held is not None

    def _fetch(self) -> Any:
        with self.handle:
            return self.handle.take_message(self._kind, True)

    def take(self) -> Any:
        """Return the oldest received message, as :meth:`Codec.decode` does, or None.

        :raises ValueError: when it is not a message of this type; names the topic.
        """
        if not self.full:
            return None
        taken, self.held = self.held, None
        try:
            return self._codec.decode(taken[0])
        except ValueError as error:
            raise ValueError(f'{self.topic}: {error}') from error

    def destroy(self) -> None:
        """Unsubscribe."""
        self._open.discard(self)
        self.handle.destroy_when_not_in_use()

    @classmethod
    def destroy_all(cls, node: Node) -> None:
        """Destroy a node's remaining mailboxes."""
        for mailbox in [one for one in cls._open if one._node is node]:
            mailbox.destroy()


class Inbox:
    """Waits for mailboxes, and lets an executor serve the rest of a node."""

    def __init__(self, node: Node, executor: Executor) -> None:
        """Set up without a wait set; `wait` creates it."""
        self._node, self._executor = node, executor
        self._wait_set: Any = None
        self._size: tuple[int, ...] = (0, 0, 0, 0)
        self._served = 0.0
        self._brisk = False

    @property
    def overdue(self) -> bool:
        """Whether it is time to serve the rest of the node."""
        return time.monotonic() - self._served >= _SERVE_PERIOD

    def wait(
        self, mailboxes: Sequence[Mailbox], seconds: float, subscriptions: Sequence[Any] = (),
        clients: Sequence[Any] = (), services: Sequence[Any] = (), timers: Sequence[Any] = (),
    ) -> tuple[list[Mailbox], bool]:
        """Return when a mailbox has a message, something else was served, or the time is over.

        :param subscriptions: the node's subscriptions to serve at once, like the other entities
            passed; all other entities wait for up to 0.05 s.
        :return: the mailboxes that have a message, and whether other callbacks may have run.
        """
        began = time.monotonic()
        # Polling is off when as many peers are busy as there are cores, as it would slow them
        # down, and when timers are given, as a due timer must not wait for a flood of messages to
        # end.
        full = [mailbox for mailbox in mailboxes if mailbox.held is not None]
        if (self._brisk and not full and not timers and len(mailboxes) < _CORES
                and not self.overdue):
            full = _look_out(mailboxes, min(seconds, _LOOK_OUT))
        if full:
            return full, False
        rest = (subscriptions, clients, services, timers)
        size = (len(mailboxes) + len(subscriptions), *map(len, rest[1:]))
        if any(a > b for a, b in zip(size, self._size, strict=True)):
            self._make(size)
        wait_set, now = self._wait_set, time.monotonic()
        wait_set.clear_entities()
        for mailbox in mailboxes:
            wait_set.add_subscription(mailbox.handle)
        first = len(mailboxes)
        for subscription in subscriptions:
            wait_set.add_subscription(subscription.handle)
        for client in clients:
            wait_set.add_client(client.handle)
        for service in services:
            wait_set.add_service(service.handle)
        for timer in timers:
            wait_set.add_timer(timer.handle)
        until = min(seconds, self._served + _SERVE_PERIOD - now)
        wait_set.wait(int(1e9 * max(until, 0.0)))
        full = [
            mailbox for index, mailbox in enumerate(mailboxes)
            if wait_set.is_ready('subscription', index)]
        self._brisk = bool(full) and time.monotonic() - began < _BRISK
        serve = any(
            wait_set.is_ready(kind, index)
            for kind, begin, entities in (
                ('subscription', first, subscriptions), ('client', 0, clients),
                ('service', 0, services), ('timer', 0, timers))
            for index in range(begin, begin + len(entities)))
        now = time.monotonic()
        if serve or self.overdue:
            self._served = now
            for _ in range(_SERVED_AT_ONCE):
                self._executor.spin_once(timeout_sec=0.0)
            return full, True
        return full, False

    def _make(self, size: tuple[int, ...]) -> None:
        subscriptions, clients, services, timers = self._size = tuple(
            max(pair) for pair in zip(size, self._size, strict=True))
        with self._node.context.handle:
            self._wait_set = _rclpy.WaitSet(
                subscriptions, 0, timers, clients, services, 0, self._node.context.handle)


def _look_out(mailboxes: Sequence[Mailbox], seconds: float) -> list[Mailbox]:
    """Poll; return the mailboxes that have a message, or none after `seconds`."""
    end = time.monotonic() + seconds
    while not (full := [mailbox for mailbox in mailboxes if mailbox.full]):
        if time.monotonic() >= end:
            break
        os.sched_yield()
    return full
