# SPDX-License-Identifier: Apache-2.0
"""Membership of a fleet: simulators that join, leave, or return with another world."""
from __future__ import annotations

import fnmatch
import time
from collections.abc import Iterator

from rclpy.node import Node

from rocket_sim_node.ros_environment import check_name
from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import difference
from rocket_sim_node.wire.client.worker import FleetWorker
from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher
from rocket_sim_node.worlds.base import WorldSpec

_LOOK_PERIOD = 1.0
"""Seconds between checks for simulators that have joined or left."""
_FIRST_LOOK_PERIOD = 0.1
"""The same, while none has joined."""
_WORLD_TYPE = 'rocket_msgs/msg/World'


def check_pattern(pattern: str) -> None:
    """Check a pattern for the namespaces of simulators.

    :raises ValueError: when it is not a valid namespace pattern.
    """
    if pattern and not pattern.startswith('/'):
        raise ValueError(
            f'simulators: got {pattern!r}, expected namespaces that begin with /, such as /sim_*')


def check_second(second: str, pattern: str) -> None:
    """Check the namespace of a second simulator.

    :raises ValueError: when it is no name, or there is a pattern as well.
    """
    if not second:
        return
    check_name('second_simulator', second)
    if pattern:
        raise ValueError(
            f'second_simulator: got {second!r}, expected none with simulators {pattern!r}')


class FleetMembership:
    """The usable simulators: all with a matching namespace, or the one in the node's own.

    The world of the first one is the reference for all others: with a pattern, of the first one to
    join; otherwise, of the one in the node's namespace.
    """

    def __init__(
        self, node: Node, options: ConnectionOptions, agent: int, pattern: str, second: str = '',
    ) -> None:
        """Start empty, or with the simulator of the node's namespace when the pattern is empty.

        :param second: namespace, below the node's own, of a simulator to use as well when it
            appears; only with an empty pattern.
        :raises ValueError: when the pattern or `second` is not a valid namespace.
        """
        check_pattern(pattern)
        check_second(second, pattern)
        self._node, self._options, self._agent, self._pattern = node, options, agent, pattern
        self._health = DiagnosticsPublisher(node, quiet=True)
        self._second = f'{node.get_namespace().rstrip("/")}/{second}' if second else ''
        self._dropped = 0
        self._workers: dict[str, FleetWorker] = {}
        self.spec: WorldSpec | None = None
        """The fleet's world, once a simulator was found."""
        self._looked = 0.0
        if not pattern:
            self._workers[''] = FleetWorker(
                Connection(node, options, agent, health=self._health))

    def __iter__(self) -> Iterator[FleetWorker]:
        """Iterate over present simulators, and departed ones that still have a job."""
        return iter(list(self._workers.values()))

    @property
    def where(self) -> str:
        """Pattern of the topics where simulators are expected; empty: the node's namespace."""
        return f'{self._pattern}/world' if self._pattern else ''

    @property
    def has_free_worker(self) -> bool:
        """Whether a simulator is free to take a job."""
        return any(worker.free for worker in self)

    @property
    def messages_dropped(self) -> int:
        """Total number of messages ignored because they did not come from the simulators."""
        return self._dropped + sum(worker.connection.messages_dropped for worker in self)

    def look(self) -> None:
        """Add simulators that have joined and remove those that have left, periodically."""
        for worker in self:
            if worker.task is None:
                worker.connection.look()
            if worker.connection.world is not worker.vetted:
                self._vet(worker)
        now = time.monotonic()
        period = _LOOK_PERIOD if self.spec else _FIRST_LOOK_PERIOD
        if not (self._pattern or self._second) or now - self._looked < period:
            return
        self._looked = now
        suffix = '/world'
        there = {
            topic.removesuffix(suffix)
            for topic, kinds in self._node.get_topic_names_and_types()
            if topic.endswith(suffix) and _WORLD_TYPE in kinds
            and self._is_wanted(topic.removesuffix(suffix))
            and self._node.count_publishers(topic)}
        for namespace in sorted(there - self._workers.keys()):
            self._workers[namespace] = FleetWorker(
                Connection(self._node, self._options, self._agent, namespace, self._health))
        for namespace, worker in list(self._workers.items()):
            worker.gone = bool(namespace) and namespace not in there
            if worker.task is None:
                worker.connection.listen()
            if worker.gone and worker.task is None:
                connection = self._workers.pop(namespace).connection
                self._dropped += connection.messages_dropped
                connection.destroy()
                self._tell(f'{namespace} has left')

    def _is_wanted(self, namespace: str) -> bool:
        """Return whether a simulator in a namespace is to be used."""
        if self._second:
            return namespace == self._second
        return fnmatch.fnmatchcase(namespace, self._pattern)

    def _vet(self, worker: FleetWorker) -> None:
        """Adopt the first simulator's world as the reference; refuse any other world.

        Any node may publish on `world`; the world of an accepted simulator shows in its answers.
        """
        own = worker is self._workers.get('')
        if self._second and not own and self.spec is None:
            return  # until the reference is known
        worker.vetted = worker.connection.world
        if worker.fits:
            return
        connection, reason = worker.connection, ''
        try:
            spec = connection.described()
            if self.spec and spec != self.spec:
                reason = f'its {difference(self.spec, spec)}'
            elif not own and connection.described_realtime:
                reason = 'its mode is realtime, expected lockstep'
            else:
                self.spec = connection.adopt_spec()
        except ValueError as error:
            if own:
                raise
            reason = str(error)
        worker.fits = not reason
        if reason:
            self._node.get_logger().error(f'{connection.name} is not used: {reason}')
        elif not own:
            self._tell(f'{connection.name} has joined')

    def _tell(self, text: str) -> None:
        count = sum(worker.fits for worker in self._workers.values())
        self._node.get_logger().info(f'{text}; simulators: {count}')

    def close(self) -> None:
        """Close all connections."""
        for worker in self:
            worker.connection.destroy()
        self._workers.clear()
