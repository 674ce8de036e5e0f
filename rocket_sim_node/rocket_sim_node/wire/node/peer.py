# SPDX-License-Identifier: Apache-2.0
"""Identity of the other side of a connection: which participant's messages count.

DDS delivers whatever any participant publishes on a topic. Each message comes with the GID of its
writer, which names the participant, and a publisher of ROS cannot choose it. So a message that
claims to be the other side's is compared with the participant that is known to be the other side.
This stops programs that use ROS. It does not stop one that composes RTPS packets itself, with the
GID of somebody else: only DDS-Security authenticates.
"""
from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from rocket_sim_node.printable import printable
from rocket_sim_node.wire.dds.endpoints import NAMELESS
from rocket_sim_node.wire.dds.endpoints import node_of
from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher

_PREFIX = 12
"""Length of the part of a GID that names the participant (RTPS 2.5, section 9.3.1.1)."""
_LOOK_PERIOD = 0.5
"""Seconds for which a look at the graph is used: a flood must not cause one for each message."""
_NAMED_WITHIN, _LOOK_AGAIN = 2.0, 0.1
"""Seconds that a report waits for the name of a node, which arrives after its messages, and
between two looks for it."""
_FAST_DDS = b'\x01\x0f'
"""Vendor of Fast DDS, with which its GIDs begin; the next two bytes stand for the machine."""
_ATTEMPTS = 5
"""Times that a publisher is created to learn its GID."""


def participant_of(gid: bytes) -> bytes:
    """Return the part of a writer's GID that names its participant; empty if it is unknown."""
    return gid[:_PREFIX]


def sender_of(info: Any) -> bytes:
    """Return the GID of the writer of a message that was taken; empty if it is not known.

    The rclpy of Jazzy does not tell it.
    """
    gid = info and info.get('publisher_gid')
    return gid['data'] if gid else b''


def writers(node: Node, topic: str, mangled: bool = False) -> dict[bytes, str]:
    """Return the GIDs of a topic's writers and the full names of their nodes, if known, or ''.

    :param mangled: whether the name is that of DDS, such as `rr/resetReply`.
    """
    return {
        bytes(end.endpoint_gid): node_of(end)
        for end in node.get_publishers_info_by_topic(topic, mangled)}


def name_of(gid: bytes, known: dict[bytes, str], own: bytes) -> str:
    """Return how messages name the sender: its node, if the graph knows it, its GID and machine.

    :param own: a GID of this process, which tells whether the sender is on the same machine.
    """
    participant = participant_of(gid)
    name = known.get(gid) or next(
        (name for one, name in known.items() if name and participant_of(one) == participant),
        NAMELESS)
    return f'{printable(name)} (GID {gid.hex(".")}{_place(gid, own)})' if gid else NAMELESS


def _place(gid: bytes, own: bytes) -> str:
    """Return where a sender runs, as far as its GID tells; DDS does not know names of hosts."""
    if not gid[:2] == own[:2] == _FAST_DDS:
        return ''
    return f', on {"this" if gid[2:4] == own[2:4] else "another"} machine'


class Peer:
    """The participant of the other side, and the count of messages dropped as not its own."""

    def __init__(self, node: Node, health: DiagnosticsPublisher, own: bytes) -> None:
        """Start without knowing the participant: all messages count.

        :param own: a GID of this process; empty if it is not known.
        """
        self._node, self._health, self._own = node, health, own
        self.participant = b''
        """First part of the GIDs of its writers; empty while it is not known."""
        self.dropped = 0
        self._unnamed: dict[tuple[str, bytes], tuple[float, float]] = {}
        """Steady-clock times, s, until which the node of a sender may still become known, and of
        the next look for it."""
        self._looked: dict[str, tuple[float, bytes, bool]] = {}

    def is_at(self, gid: bytes) -> bool:
        """Whether a writer is one of the peer's; true for all while it is not known."""
        return not self.participant or not gid or participant_of(gid) == self.participant

    def accepts(self, topic: str, gid: bytes) -> bool:
        """Return whether a message that claims to be the peer's counts.

        It does if the peer wrote it, and if the peer has no writer on this topic at all: a
        relay stands between the two, whose messages cannot be told from others.
        """
        return self.is_at(gid) or not self._writes(topic)

    def calls(self, services: Sequence[str], gid: bytes) -> bool:
        """Return whether a request that claims to be the peer's counts, as :meth:`accepts`.

        :param services: all names of the service.
        A client that the graph does not know counts: its GID may not name a participant.
        """
        if self.is_at(gid):
            return True
        clients = set(map(participant_of, self.clients(services)))
        return not {participant_of(gid), self.participant} <= clients

    def clients(self, services: Sequence[str]) -> dict[bytes, str]:
        """Return the GIDs of the clients of services and the full names of their nodes."""
        return {
            gid: name for service in services
            for gid, name in writers(self._node, f'rq{service}Request', mangled=True).items()}

    def _writes(self, topic: str) -> bool:
        """Return whether the peer has a writer on a topic."""
        now = time.monotonic()
        looked, participant, found = self._looked.get(topic, (0.0, b'', False))
        if participant != self.participant or now - looked > _LOOK_PERIOD:
            found = any(map(self.is_at, writers(self._node, topic)))
            self._looked[topic] = now, self.participant, found
        return found

    def drop(
        self, topic: str, gid: bytes, why: str, known: dict[bytes, str] | None = None,
    ) -> None:
        """Count a dropped message, and report its sender once.

        :param topic: or service.
        :param why: the text after the name of the sender.
        :param known: the names of a service's clients, one of which called: it is reported at
            once, as no other call may follow. None: the names of the topic's writers.
        """
        self.dropped += 1
        source = topic, participant_of(gid)

        def text() -> str:
            now = time.monotonic()
            until, again = self._unnamed.setdefault(source, (now + _NAMED_WITHIN, now))
            if now < again:
                return ''
            name = self.named(gid, known or writers(self._node, topic))
            if known is None and name.startswith(NAMELESS) and now < until:
                self._unnamed[source] = until, now + _LOOK_AGAIN
                return ''
            return f'{topic}: {name} {why}'

        self._health.fault(f'dropped on {topic}', source, text)

    def named(self, gid: bytes, known: dict[bytes, str]) -> str:
        """Return how messages name a sender, as :func:`name_of` does."""
        return name_of(gid, known, self._own)


def known_publisher(
    node: Node, kind: Any, topic: str, profile: QoSProfile,
) -> tuple[Publisher, bytes]:
    """Create a publisher; return it and its GID, empty when it cannot be told.

    rclpy does not tell the GID: it is the one that is new on the topic. If another node of the
    same name appears at the same moment, two are new, and the publisher is created again.
    """
    own = f'{node.get_namespace().rstrip("/")}/{node.get_name()}'
    for attempt in range(_ATTEMPTS):
        before = set(writers(node, topic))
        publisher = node.create_publisher(kind, topic, profile)
        new = [gid for gid, name in writers(node, topic).items()
               if gid not in before and name == own]
        if len(new) == 1:
            return publisher, new[0]
        if not new or attempt == _ATTEMPTS - 1:
            break
        node.destroy_publisher(publisher)
    return publisher, b''
