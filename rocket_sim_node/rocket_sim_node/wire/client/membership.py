# SPDX-License-Identifier: Apache-2.0
"""Who flies for an agent: simulators that join, leave, and come back as another world."""
from __future__ import annotations

import fnmatch
import time
from collections.abc import Iterator

from rclpy.node import Node

from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import difference
from rocket_sim_node.wire.client.worker import FleetWorker
from rocket_sim_node.worlds.base import WorldSpec

_LOOK_PERIOD = 1.0
"""s between two looks at who has joined and who has left"""
_FIRST_LOOK_PERIOD = 0.1
"""s, while nobody has joined"""
_WORLD_TYPE = 'rocket_msgs/msg/World'


def check_pattern(pattern: str) -> None:
    """Check what simulators shall be called.

    :raises ValueError: when that is no namespace.
    """
    if pattern and not pattern.startswith('/'):
        raise ValueError(
            f'simulators: got {pattern!r}, expected namespaces that begin with /, such as /sim_*')


class FleetMembership:
    """The simulators that may fly: all whose namespace matches, or the one of the node's own.

    The world of the first one is that of all.
    """

    def __init__(self, node: Node, options: ConnectionOptions, agent: int, pattern: str) -> None:
        """Begin with nobody, or with the one of the node's namespace when the pattern is empty.

        :raises ValueError: when the pattern is no namespace.
        """
        check_pattern(pattern)
        self._node, self._options, self._agent, self._pattern = node, options, agent, pattern
        self._members: dict[str, FleetWorker] = {}
        self.spec: WorldSpec | None = None
        """the world, once somebody was there"""
        self._looked = 0.0
        if not pattern:
            self._members[''] = FleetWorker(Connection(node, options, agent))

    def __iter__(self) -> Iterator[FleetWorker]:
        """Give those that are there, and those that left while they flew."""
        return iter(list(self._members.values()))

    @property
    def where(self) -> str:
        """Where simulators are looked for, as the log shall say it; empty: where the node is."""
        return f'{self._pattern}/world' if self._pattern else ''

    @property
    def anybody_free(self) -> bool:
        """Whether something can be given to one of them."""
        return any(member.free for member in self)

    def look(self) -> None:
        """Take in who has joined, part with who has left, now and then."""
        for member in self:
            if member.link.world is not member.vetted:
                self._vet(member)
        now = time.monotonic()
        period = _LOOK_PERIOD if self.spec else _FIRST_LOOK_PERIOD
        if not self._pattern or now - self._looked < period:
            return
        self._looked = now
        suffix = '/world'
        there = {
            topic.removesuffix(suffix)
            for topic, kinds in self._node.get_topic_names_and_types()
            if topic.endswith(suffix) and _WORLD_TYPE in kinds
            and fnmatch.fnmatchcase(topic.removesuffix(suffix), self._pattern)
            and self._node.count_publishers(topic)}
        for namespace in sorted(there - self._members.keys()):
            self._members[namespace] = FleetWorker(
                Connection(self._node, self._options, self._agent, namespace))
        for namespace, member in list(self._members.items()):
            member.gone = namespace not in there
            if member.task is None:
                member.link.listen()
            if member.gone and member.task is None:
                self._members.pop(namespace).link.destroy()
                self._tell(f'{namespace} has left')

    def _vet(self, member: FleetWorker) -> None:
        """Take the world of the first simulator for that of all; refuse another one.

        On `world` anybody may speak: what one is that was taken in, its answers tell.
        """
        member.vetted = member.link.world
        if member.fits:
            return
        link, reason = member.link, ''
        try:
            spec = link.described()
            if self.spec and spec != self.spec:
                reason = f'its {difference(self.spec, spec)}'
            elif self._pattern and link.described_realtime:
                reason = 'its mode is realtime, expected lockstep'
            else:
                self.spec = link.adopt_spec()
        except ValueError as error:
            if not self._pattern:
                raise
            reason = str(error)
        member.fits = not reason
        if reason:
            self._node.get_logger().error(f'{link.name} is not flown: {reason}')
        elif self._pattern:
            self._tell(f'{link.name} has joined')

    def _tell(self, text: str) -> None:
        count = sum(member.fits for member in self._members.values())
        self._node.get_logger().info(f'{text}; simulators: {count}')

    def close(self) -> None:
        """Withdraw from the topics and services of all."""
        for member in self:
            member.link.destroy()
        self._members.clear()
