# SPDX-License-Identifier: Apache-2.0
"""Low-latency waiting for the messages of a step, bypassing the executor.

An executor rebuilds its list of entities for each message, or passes events between threads, and
converts messages to Python objects: that takes longer than the transfer through DDS. A lock-step
exchange waits for one topic of each peer only. Its topics therefore have subscriptions that are
not added to an executor and return bytes, and their own wait set, used as in
`rclpy.wait_for_message`. The node's executor serves everything else in between.

If messages arrive quickly, the node polls for a while before it sleeps in the wait set, and
yields its core in between. Falling asleep and waking up takes longer than most answers: a halted
core wakes slowly, with cold caches. DDS's own threads can preempt the polling at any time.

Where this rclpy lacks what that takes (see `distributions.subscribe`), the executor delivers the
bytes: the same messages, more slowly.
"""
from __future__ import annotations

import os
import time
import weakref
from collections import deque
from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from typing import ClassVar

from rclpy.executors import Executor
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rocket_sim_node.wire.distributions import make_client
from rocket_sim_node.wire.distributions import make_guard_condition
from rocket_sim_node.wire.distributions import make_wait_set
from rocket_sim_node.wire.distributions import subscribe
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.wire.node import clock_steps
from rocket_sim_node.wire.node.peer import sender_of

_SERVED_AT_ONCE = 16
"""Maximum callbacks per run of the executor."""
_IDLE = 3
"""Number of spins without a callback after which a run of the executor ends."""


@dataclass(frozen=True)
class Polling:
    """When and for how long a wait set is polled before the node sleeps in it."""

    seconds: float = 0.0006
    """Longer than most answers of a simulator take. Polling longer slows down other processes on a
    machine with two cores."""
    after: float = 0.0008
    """Poll if the previous message arrived within this time, s."""
    serve_period: float = 0.05
    """Seconds between executor runs that serve the rest of the node."""
    cores: int = len(os.sched_getaffinity(0))
    """Do not poll when as many peers are busy as there are cores."""


POLLING = Polling()


class PolledEntity:
    """An entity that is read by polling instead of callbacks.

    The node does not know it, so call `destroy_all` before the node is destroyed: a remaining
    entity keeps the participant alive, and peers do not notice that it is gone.
    """

    _open: ClassVar[weakref.WeakSet[PolledEntity]] = weakref.WeakSet()

    def __init__(self, handle: Any, make_public: Callable[[], Any], node: Node) -> None:
        """Take care of an entity of a node.

        :param handle: of rclpy's own C++ part; None: the node's executor serves what
            `make_public` returns.
        """
        self._node, self.handle = node, handle
        self._public = make_public() if handle is None else None
        self._open.add(self)

    def destroy(self) -> None:
        """Remove it from DDS."""
        self._open.discard(self)
        if self.handle is not None:
            self.handle.destroy_when_not_in_use()
        else:
            self._destroy_public()

    def _destroy_public(self) -> None:
        self._node.destroy_subscription(self._public)

    @classmethod
    def destroy_all(cls, node: Node) -> None:
        """Destroy a node's remaining polled entities, of all kinds."""
        for one in [one for one in cls._open if one._node is node]:
            one.destroy()


class ArraySubscription(PolledEntity):
    """A subscription that is read by polling, and decodes messages to arrays."""

    def __init__(self, node: Node, kind: Any, topic: str, profile: QoSProfile) -> None:
        """Subscribe, with the node's remapping and namespace."""
        self._kind, self.topic = kind, topic
        self._codec = Codec(kind)
        self._delivered: deque[tuple[bytes, None]] = deque(maxlen=profile.depth)
        super().__init__(
            subscribe(node, kind, topic, profile),
            lambda: node.create_subscription(kind, topic, self._deliver, profile, raw=True), node)
        self.held: Any = None
        """A message already taken from DDS; the wait set no longer reports it."""
        self.sender = b''
        """GID of the writer of the message that was returned last; empty if it is not known."""

    @property
    def full(self) -> bool:
        """Whether a message has arrived."""
        if self.held is None:
            self.held = self._fetch()
        return self.held is not None

    def _deliver(self, data: bytes) -> None:
        # With a second argument, for details of the message, EventsExecutor fails in rclpy 7, 9.
        self._delivered.append((data, None))

    def _fetch(self) -> Any:
        if self.handle is None:
            return self._delivered.popleft() if self._delivered else None
        with self.handle:
            return self.handle.take_message(self._kind, True)

    def take(self) -> Any:
        """Return the oldest received message, as :meth:`Codec.decode` does, or None.

        :raises ValueError: when it is not a message of this type; names the topic.
        """
        if not self.full:
            return None
        taken, self.held = self.held, None
        self.sender = sender_of(taken[1])
        try:
            return self._codec.decode(taken[0])
        except ValueError as error:
            raise ValueError(f'{self.topic}: {error}') from error


class MessageSubscription(PolledEntity):
    """A subscription to any kind of message that is read by polling, with the sender.

    A callback that takes the sender as well makes rclpy's `EventsExecutor` fail (rclpy 7, 9).
    """

    def __init__(self, node: Node, kind: Any, topic: str, profile: QoSProfile) -> None:
        """Subscribe, with the node's remapping and namespace."""
        self._kind, self.topic = kind, node.resolve_topic_name(topic)
        self._delivered: deque[Any] = deque(maxlen=profile.depth)
        super().__init__(
            subscribe(node, kind, topic, profile),
            lambda: node.create_subscription(kind, topic, self._deliver, profile), node)

    def _deliver(self, message: Any) -> None:
        self._delivered.append(message)

    def take(self) -> tuple[Any, bytes] | None:
        """Return the oldest message received and the GID of its writer, or None.

        Bytes that are no message of this kind are left out by the middleware. The GID is empty
        where it is not known.
        """
        if self.handle is None:
            return (self._delivered.popleft(), b'') if self._delivered else None
        with self.handle:
            taken = self.handle.take_message(self._kind, False)
        return None if taken is None else (taken[0], sender_of(taken[1]))


class PolledClient(PolledEntity):
    """A service's client that is read by polling.

    It returns every answer to a request: `rclpy.client.Client`, used where rclpy has changed,
    returns the first one only, which any second server of the same name may have sent.
    """

    def __init__(self, node: Node, kind: Any, name: str) -> None:
        """Create the client, with the node's remapping and namespace."""
        self._kind, self.srv_name = kind, node.resolve_service_name(name)
        self._pending: dict[int, Any] = {}
        super().__init__(
            make_client(node, kind, name), lambda: node.create_client(kind, name), node)
        self.settled = 0
        """Number of the last request that was answered; 0 before the first."""
        self._sent = 0

    def _destroy_public(self) -> None:
        self._node.destroy_client(self._public)

    def service_is_ready(self) -> bool:
        """Return whether there is a server."""
        if self._public is not None:
            return bool(self._public.service_is_ready())
        with self.handle:
            return bool(self.handle.service_server_is_available())

    def send(self, request: Any) -> int:
        """Send a request; return its number."""
        if self._public is not None:
            self._sent += 1
            self._pending[self._sent] = self._public.call_async(request)
            return self._sent
        with self.handle:
            return int(self.handle.send_request(request))

    def take(self) -> tuple[int, Any] | None:
        """Return the oldest answer received, behind the number of its request, or None."""
        if self._public is not None:
            for number, future in self._pending.items():
                if future.done():
                    return number, self._pending.pop(number).result()
            return None
        with self.handle:
            header, response = self.handle.take_response(self._kind.Response)
        return None if header is None else (header.request_id.sequence_number, response)


class PollingWaitSet:
    """Waits for messages of array subscriptions, and lets an executor serve the rest of a node."""

    def __init__(self, node: Node, executor: Executor, polling: Polling = POLLING) -> None:
        """Set up without a wait set; `wait` creates it."""
        self._node, self._executor, self._polling = node, executor, polling
        self._wait_set: Any = None
        self._guard: Any = None
        self._size: tuple[int, ...] = (0, 0, 0, 0)
        self._served = 0.0
        self._brisk = False

    @property
    def overdue(self) -> bool:
        """Whether it is time to serve the rest of the node."""
        return time.monotonic() - self._served >= self._polling.serve_period

    def wait(
        self, polled: Sequence[ArraySubscription], seconds: float,
        subscriptions: Sequence[Any] = (), clients: Sequence[Any] = (),
        services: Sequence[Any] = (), timers: Sequence[Any] = (),
    ) -> tuple[list[ArraySubscription], bool]:
        """Return when a message has arrived, something else was served, or the time is over.

        :param polled: the subscriptions whose messages end the wait.
        :param subscriptions: the node's subscriptions to serve at once, like the other entities
            passed; all other entities wait for up to 0.05 s.
        :return: those of `polled` that have a message, and whether other callbacks may have run.
        """
        if any(one.handle is None for one in (*polled, *subscriptions, *clients)):
            return self._wait_publicly(polled, seconds)
        began = time.monotonic()
        # Polling is off when as many peers are busy as there are cores, as it would slow them
        # down, and when timers are given, as a due timer must not wait for a flood of messages to
        # end.
        full = [subscription for subscription in polled if subscription.held is not None]
        if (self._brisk and not full and not timers and len(polled) < self._polling.cores
                and not self.overdue):
            full = _poll(polled, min(seconds, self._polling.seconds))
        if full:
            return full, False
        rest = (subscriptions, clients, services, timers)
        size = (len(polled) + len(subscriptions), *map(len, rest[1:]))
        if any(a > b for a, b in zip(size, self._size, strict=True)):
            self._make(size)
        wait_set, now = self._wait_set, time.monotonic()
        wait_set.clear_entities()
        wait_set.add_guard_condition(self._guard)
        for subscription in polled:
            wait_set.add_subscription(subscription.handle)
        first = len(polled)
        for subscription in subscriptions:
            wait_set.add_subscription(subscription.handle)
        for client in clients:
            wait_set.add_client(client.handle)
        for service in services:
            wait_set.add_service(service.handle)
        for timer in timers:
            wait_set.add_timer(timer.handle)
        until = min(seconds, self._served + self._polling.serve_period - now)
        wait_set.wait(int(1e9 * max(until, 0.0)))
        full = [
            subscription for index, subscription in enumerate(polled)
            if wait_set.is_ready('subscription', index)]
        self._brisk = bool(full) and time.monotonic() - began < self._polling.after
        serve = any(
            wait_set.is_ready(kind, index)
            for kind, begin, entities in (
                ('subscription', first, subscriptions), ('client', 0, clients),
                ('service', 0, services), ('timer', 0, timers))
            for index in range(begin, begin + len(entities)))
        now = time.monotonic()
        if serve or self.overdue:
            self._served = now
            _serve(self._executor)
            return full, True
        return full, False

    def _wait_publicly(
        self, polled: Sequence[ArraySubscription], seconds: float,
    ) -> tuple[list[ArraySubscription], bool]:
        """Wait as :meth:`wait` does, by the executor alone, which serves the whole node."""
        if any(subscription.full for subscription in polled):
            seconds = 0.0
        self._executor.spin_once(timeout_sec=max(min(seconds, self._polling.serve_period), 0.0))
        return [subscription for subscription in polled if subscription.full], True

    def _make(self, size: tuple[int, ...]) -> None:
        subscriptions, clients, services, timers = self._size = tuple(
            max(pair) for pair in zip(size, self._size, strict=True))
        self._wait_set = make_wait_set(self._node, subscriptions, timers, clients, services)
        if self._guard is None:
            self._guard = make_guard_condition(self._node)
            clock_steps.WATCH.add(self, lambda one: one._guard.trigger_guard_condition())


def _serve(executor: Executor) -> None:
    """Run the callbacks that are due, at most 16, and those that they make due.

    `spin_once` runs one and does not report whether there was any; an idle one takes 0.08 ms. An
    `EventsExecutor` runs a task after all that was due when the task was created, and looks for
    due timers between tasks. So nothing is due any more when only such tasks have run for some
    spins. Other executors run tasks first.
    """
    if isinstance(executor, SingleThreadedExecutor):
        for _ in range(_SERVED_AT_ONCE):
            executor.spin_once(timeout_sec=0.0)
        return
    reached = [True]
    idle = 0
    for _ in range(_SERVED_AT_ONCE):
        if reached:
            reached.clear()
            executor.create_task(reached.append, True)
        executor.spin_once(timeout_sec=0.0)
        idle = idle + 1 if reached else 0
        if idle == _IDLE:
            break


def _poll(polled: Sequence[ArraySubscription], seconds: float) -> list[ArraySubscription]:
    """Poll; return the subscriptions that have a message, or none after `seconds`."""
    end = time.monotonic() + seconds
    while not (full := [subscription for subscription in polled if subscription.full]):
        if time.monotonic() >= end:
            break
        os.sched_yield()
    return full
