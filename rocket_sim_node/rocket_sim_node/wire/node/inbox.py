# SPDX-License-Identifier: Apache-2.0
"""Waiting for the messages of a step with as little as possible between the network and us.

An executor collects all that a node has, for each message anew, or hands events from thread to
thread, and makes Python objects of messages: that takes longer than the way through DDS. A
lock-step exchange waits for one topic of each far end and nothing else. So its topics have
subscriptions that no executor knows, which hand out bytes, and a wait set for them, used as
`rclpy.wait_for_message` does. What else the node has is served by its executor in between.

Before it sleeps in the wait set, who exchanges briskly looks for a message for a while and yields
its core in between. To fall asleep and be woken costs more than most answers take to come: a core
that has halted wakes late and cold. DDS's own threads get the core whenever they want it.
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
"""s between two looks at what else the node has"""
_LOOK_OUT = 0.0006
"""s of looking for a message before sleeping: more than most answers of a simulator take; more
than that takes from others on a machine with two cores"""
_BRISK = 0.0008
"""s within which the message before had come, where it is worth it"""
_CORES = len(os.sched_getaffinity(0))
_SERVED_AT_ONCE = 16
"""callbacks, at most: an executor serves one at a time and does not say whether there was any"""


class Mailbox:
    """A subscription whose messages are taken by whoever looks for them.

    The node does not know it, so `destroy_all` comes before the node's own end: a subscription
    that is left keeps the participant, and peers do not hear that it is gone.
    """

    _open: ClassVar[weakref.WeakSet[Mailbox]] = weakref.WeakSet()

    def __init__(self, node: Node, kind: Any, topic: str, profile: QoSProfile) -> None:
        """Subscribe; remapping and namespaces are those of the node."""
        check_is_valid_msg_type(kind)  # which loads what the type needs in C
        self._node, self._kind, self.topic = node, kind, topic
        self._codec = Codec(kind)
        with node.handle:
            self.handle = _rclpy.Subscription(
                node.handle, kind, topic, profile.get_c_qos_profile())
        self.held: Any = None
        """what came first, once somebody has looked: a wait set knows nothing of it any more"""
        self._open.add(self)

    @property
    def full(self) -> bool:
        """Whether a message has come."""
        if self.held is None:
            self.held = self._fetch()
        return self.held is not None

    def _fetch(self) -> Any:
        with self.handle:
            return self.handle.take_message(self._kind, True)

    def take(self) -> Any:
        """Return the oldest message that has come, as :meth:`Codec.decode` does; None without.

        :raises ValueError: when it is no message of this type; names the topic.
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
        """Unsubscribe those of a node that are left."""
        for mailbox in [one for one in cls._open if one._node is node]:
            mailbox.destroy()


class Inbox:
    """Waits for mailboxes, and has an executor serve the rest of a node."""

    def __init__(self, node: Node, executor: Executor) -> None:
        """Wait for nothing yet."""
        self._node, self._executor = node, executor
        self._wait_set: Any = None
        self._size: tuple[int, ...] = (0, 0, 0, 0)
        self._served = 0.0
        self._brisk = False

    @property
    def overdue(self) -> bool:
        """Whether it is time to look at what else the node has."""
        return time.monotonic() - self._served >= _SERVE_PERIOD

    def wait(
        self, mailboxes: Sequence[Mailbox], seconds: float, subscriptions: Sequence[Any] = (),
        clients: Sequence[Any] = (), services: Sequence[Any] = (), timers: Sequence[Any] = (),
    ) -> tuple[list[Mailbox], bool]:
        """Return when a mailbox has a message or something was served; after the time at last.

        :param subscriptions: of the node, which the executor shall serve at once, as the other
            kinds of entities that are named; those that are not wait for up to 0.05 s.
        :return: the mailboxes that have a message, and whether something else may have happened.
        """
        began = time.monotonic()
        # With as many far ends at work as there are cores, one who looks out is in their way; and
        # a timer that is due must not wait for a flood of messages to end.
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
    """Return those that have a message as soon as there are some; none after the time."""
    end = time.monotonic() + seconds
    while not (full := [mailbox for mailbox in mailboxes if mailbox.full]):
        if time.monotonic() >= end:
            break
        os.sched_yield()
    return full
