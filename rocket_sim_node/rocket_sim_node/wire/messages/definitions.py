# SPDX-License-Identifier: Apache-2.0
"""Check that publishers and subscribers of a topic use the same message definition.

With our Fast DDS profiles, DDS matches endpoints by the names of topic and type, and ROS 2 checks
nothing more: a node built before a field was added would misread the bytes. Each endpoint does,
however, announce a hash of its definition (REP 2016), which `ros2 topic info -v` shows.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from rocket_sim_node.printable import printable
from rocket_sim_node.wire.dds.endpoints import NAMELESS
from rocket_sim_node.wire.dds.endpoints import node_of


class DefinitionsDiffer(ValueError):
    """Two nodes were built from different definitions of a message."""


def check_definitions(node: Node, reads: Iterable[str], writes: Iterable[str] = ()) -> bool:
    """Check that the peers on these topics use this node's message definitions.

    If a topic has several peers, one that matches suffices. A peer without a hash, as before ROS 2
    Iron, is accepted. Returns whether each topic has a peer; it may not have been discovered yet.

    :param reads: topics that the node subscribes to, as the node names them.
    :param writes: topics that it publishes on.
    :raises DefinitionsDiffer: with topic, node, its hash and the expected hash.
    """
    return all([
        *(_check(node, topic, node.get_subscriptions_info_by_topic(topic),
                 node.get_publishers_info_by_topic(topic)) for topic in reads),
        *(_check(node, topic, node.get_publishers_info_by_topic(topic),
                 node.get_subscriptions_info_by_topic(topic)) for topic in writes)])


def _check(node: Node, topic: str, near: Sequence[Any], far: Sequence[Any]) -> bool:
    whoami = f'{node.get_namespace().rstrip("/")}/{node.get_name()}'  # as `node_of` names it
    # Endpoints of our own node name count too: a killed instance may still be listed.
    own = {hash_ for name, hash_ in hashes(near) if name == whoami}
    theirs = hashes(far)
    if not own or not theirs or any(hash_ in own for _, hash_ in theirs):
        return bool(far)
    name, hash_ = theirs[0]
    raise DefinitionsDiffer(
        f'{topic}: {printable(name) or NAMELESS} defines its messages as {hash_}, expected '
        f'{" or ".join(sorted(own))}: one of the two nodes was built from another rocket_msgs')


def hashes(ends: Iterable[Any]) -> list[tuple[str, str]]:
    """Return the node, '' while it is not known, and hash of endpoints that announce a hash."""
    known = ((node_of(end), getattr(end, 'topic_type_hash', None)) for end in ends)
    return [(node, str(hash_)) for node, hash_ in known if hash_ is not None and hash_.version > 0]
