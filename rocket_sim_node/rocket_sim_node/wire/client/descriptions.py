# SPDX-License-Identifier: Apache-2.0
"""Descriptions on topic `world`: which participant is the simulator, and what it says.

Any participant may publish there. The first one that describes a world and publishes observations
is the simulator, until it has left, or falls silent while something is asked of it and another one
describes a world: a simulator that was killed and started again. As long as it has not announced
an answer that arrived, another one that has is the simulator instead.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field

from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.peer import Peer
from rocket_sim_node.wire.node.peer import participant_of
from rocket_sim_node.wire.node.peer import writers
from rocket_sim_node.wire.node.polling import MessageSubscription

_SILENT = 0.5
"""Seconds without an answer after which another participant may be the simulator."""
_MOST = 8
"""Maximum number of other participants, and of digests of answers, that are kept."""


@dataclass
class _Described:
    """The descriptions that one participant published."""

    gid: bytes = b''
    world: msg.World | None = None
    answers: list[bytes] = field(default_factory=list)
    """Digests of the answers of services that it announced."""
    proven: bool = False
    """Whether an answer that it announced has arrived."""

    def note(self, gid: bytes, world: msg.World) -> None:
        """Keep a description."""
        self.gid, self.world = gid, world
        self.answers = [*self.answers[1 - _MOST:], bytes(world.answer)]


class Descriptions:
    """The simulator's descriptions of itself; other participants' descriptions are put aside."""

    def __init__(
        self, node: Node, prefix: str, peer: Peer, accept: Callable[[msg.World], bool],
    ) -> None:
        """Subscribe.

        :param prefix: of the topics, with its trailing slash, or empty.
        :param peer: is told which participant is the simulator.
        :param accept: returns whether a description may be used; told of each one in use.
        """
        self._node, self._peer, self._accept = node, peer, accept
        self._observation = f'{prefix}observation'
        self._now = _Described()
        self._others: dict[bytes, _Described] = {}
        self.subscription = MessageSubscription(node, msg.World, f'{prefix}world', qos.READ_WORLD)
        self.topic = self.subscription.topic
        """Full name of the topic."""

    @property
    def world(self) -> msg.World | None:
        """The simulator's latest description, as read last."""
        return self._now.world

    @world.setter
    def world(self, message: msg.World | None) -> None:
        self._now.world = message

    def read(self) -> None:
        """Read the descriptions that have arrived."""
        while (taken := self.subscription.take()) is not None:
            self._read_one(*taken)

    def _read_one(self, message: msg.World, gid: bytes) -> None:
        if self._is_simulator(gid):
            if self._accept(message):
                if not self._peer.is_at(gid):
                    self._now = _Described()
                self._peer.participant = participant_of(gid)
                self._now.note(gid, message)
            return
        others = self._others
        others.setdefault(participant_of(gid), _Described()).note(gid, message)
        if len(others) > _MOST:
            del others[next(iter(others))]

    def _is_simulator(self, gid: bytes) -> bool:
        """Return whether a participant is the simulator: known as such, or by what it writes.

        Without a GID it is not to be told from others, so it is.
        """
        if not gid or (self._peer.participant and self._peer.is_at(gid)):
            return True
        describing = set(map(participant_of, writers(self._node, self.topic)))
        whole = describing & set(map(participant_of, writers(self._node, self._observation)))
        who, known = participant_of(gid), self._peer.participant
        if known in describing:
            return who in whole and known not in whole
        return who in whole or not whole

    def reconsider(self, silent: float) -> None:
        """Take another participant for the simulator, if the known one has fallen silent.

        :param silent: seconds for which it has not answered what was asked.
        """
        self.read()
        if silent < _SILENT or not self._others:
            return
        who, found = self._others.popitem()
        assert found.world is not None
        if self._accept(found.world):
            self._peer.participant, self._now = who, found
            self._others.clear()

    def expose(self) -> None:
        """Report the other participants: the simulator has answered, so it was not restarted."""
        for other in self._others.values():
            name = self._peer.named(self._now.gid, writers(self._node, self.topic))
            self._peer.drop(
                self.topic, other.gid, 'also describes a world on this topic: ignored, because '
                f'{name} answers; give each simulator a namespace of its own')
        self._others.clear()

    # Answers of services

    def await_answer(self) -> None:
        """Forget the answers that were announced so far."""
        for one in (self._now, *self._others.values()):
            one.answers.clear()

    def announced(self, digest: bytes) -> bool:
        """Return whether the simulator has announced an answer, or announces none at all."""
        if not self._now.proven and digest not in self._now.answers:
            self._believe(digest)
        if digest in self._now.answers:
            self._now.proven = True
            return True
        world = self._now.world
        return world is None or not len(world.answer)

    def _believe(self, digest: bytes) -> None:
        """Take the participant that announced an answer for the simulator."""
        for participant, other in self._others.items():
            if digest in other.answers and other.world is not None and self._accept(other.world):
                self._peer.participant, self._now = participant, other
                del self._others[participant]
                return
