# SPDX-License-Identifier: Apache-2.0
"""Detects a second simulator on the same topics."""
from __future__ import annotations

from typing import ClassVar

from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher
from rocket_sim_node.wire.node.peer import Peer
from rocket_sim_node.wire.node.peer import participant_of
from rocket_sim_node.wire.node.peer import writers
from rocket_sim_node.wire.node.polling import MessageSubscription


class DuplicateDetector:
    """The other participants that describe a world on this simulator's topics.

    Only a message counts: the graph still lists a simulator that was killed for 20 s.
    """

    PERIOD: ClassVar[float] = 1.0
    """Seconds between two looks."""

    def __init__(
        self, node: Node, peer: Peer, health: DiagnosticsPublisher, own: bytes,
    ) -> None:
        """Start listening.

        :param peer: names senders.
        :param own: the participant of this node; empty if it is not known: nothing is noticed.
        """
        self._node, self._peer, self._health, self._own = node, peer, health, own
        self._subscription = MessageSubscription(node, msg.World, 'world', qos.READ_WORLD)
        self._known: dict[bytes, bytes] = {}
        self._new: set[bytes] = set()
        """Writers whose message has come and which the graph does not list yet."""

    def look(self) -> None:
        """Report an error for each of them that is there."""
        while (taken := self._subscription.take()) is not None:
            gid = taken[1]
            if self._own and gid and participant_of(gid) != self._own:
                self._known[participant_of(gid)] = gid
                self._new.add(gid)
        if not self._known:
            return
        there = writers(self._node, 'world')
        self._known = {
            one: gid for one, gid in self._known.items() if gid in there or gid in self._new}
        self._new -= there.keys()
        for gid in self._known.values():
            if gid not in there:
                continue
            name = self._peer.named(gid, there)
            self._health.fault('second simulator seen', gid, lambda name=name: (  # type: ignore[misc]
                f'world: {name} also describes a world on this topic; give each simulator a '
                'namespace of its own'))
