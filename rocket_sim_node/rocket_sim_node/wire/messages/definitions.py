# SPDX-License-Identifier: Apache-2.0
"""Whether both ends of a topic were built from the same definition of its message.

DDS matches ends by the names of topic and type, as our profiles for Fast DDS have it, and ROS 2
compares no more: a node that was built before a message got another field would read its bytes as
something else. Each end tells a hash of its definition, though (REP 2016), which
`ros2 topic info -v` shows.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from rocket_sim_node.printable import printable


class DefinitionsDiffer(ValueError):
    """Two nodes were built from different definitions of a message."""


def check_definitions(node: Node, reads: Iterable[str], writes: Iterable[str] = ()) -> bool:
    """Make sure that the far ends of topics define their messages as this node does.

    Where there are several, one that agrees will do. Who tells no hash, as before ROS 2 Iron, is
    believed. Tell whether each topic has a far end: it may not have been discovered yet.

    :param reads: topics that the node subscribes to, as it names them.
    :param writes: topics that it publishes on.
    :raises DefinitionsDiffer: with topic, node, hash, and the expected one.
    """
    return all([
        *(_check(node, topic, node.get_subscriptions_info_by_topic(topic),
                 node.get_publishers_info_by_topic(topic)) for topic in reads),
        *(_check(node, topic, node.get_publishers_info_by_topic(topic),
                 node.get_subscriptions_info_by_topic(topic)) for topic in writes)])


def _check(node: Node, topic: str, near: Sequence[Any], far: Sequence[Any]) -> bool:
    whoami = (node.get_name(), node.get_namespace())
    # Another of our name counts as well: it may be one that was killed, and is not forgotten yet.
    own = {hash_ for name, hash_ in hashes(near) if name == whoami}
    theirs = hashes(far)
    if not own or not theirs or any(hash_ in own for _, hash_ in theirs):
        return bool(far)
    (name, namespace), hash_ = theirs[0]
    raise DefinitionsDiffer(
        f'{topic}: {printable(namespace.rstrip("/"))}/{printable(name)} defines its messages as '
        f'{hash_}, expected '
        f'{" or ".join(sorted(own))}: one of the two nodes was built from another rocket_msgs')


def hashes(ends: Iterable[Any]) -> list[tuple[tuple[str, str], str]]:
    """Return name, namespace and hash of ends that tell one."""
    known = (((end.node_name, end.node_namespace), getattr(end, 'topic_type_hash', None))
             for end in ends)
    return [(node, str(hash_)) for node, hash_ in known if hash_ is not None and hash_.version > 0]
