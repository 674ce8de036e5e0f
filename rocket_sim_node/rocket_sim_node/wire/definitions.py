# SPDX-License-Identifier: Apache-2.0
"""Whether both ends of a topic were built from the same definition of its message.

DDS matches ends by the names of topic and type, as our profiles for Fast DDS have it, and ROS 2
compares no more: a node that was built before a message got another field would read its bytes as
something else. Each end tells a hash of its definition, though (REP 2016), which
`ros2 topic info -v` shows.
"""
from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rclpy.node import Node


class DefinitionsDiffer(ValueError):
    """Two nodes were built from different definitions of a message."""


def check_definitions(node: Node, topics: Iterable[str]) -> None:
    """Make sure that those who publish on topics define their messages as this node does.

    Where several do, one that agrees will do. Who tells no hash, as before ROS 2 Iron, is
    believed.

    :param node: which subscribes to the topics.
    :param topics: as the node names them.
    :raises DefinitionsDiffer: with topic, node, hash, and the expected one.
    """
    whoami = (node.get_name(), node.get_namespace())
    for topic in topics:
        own = next((hash_ for name, hash_ in _hashes(node.get_subscriptions_info_by_topic(topic))
                    if name == whoami), None)
        far = _hashes(node.get_publishers_info_by_topic(topic))
        if own is None or not far or any(hash_ == own for _, hash_ in far):
            continue
        (name, namespace), hash_ = far[0]
        raise DefinitionsDiffer(
            f'{topic}: {namespace.rstrip("/")}/{name} defines its messages as {hash_}, expected '
            f'{own}: one of the two nodes was built from another rocket_msgs')


def _hashes(ends: Iterable[Any]) -> list[tuple[tuple[str, str], str]]:
    """Return name, namespace and hash of ends that tell one."""
    known = (((end.node_name, end.node_namespace), getattr(end, 'topic_type_hash', None))
             for end in ends)
    return [(node, str(hash_)) for node, hash_ in known if hash_ is not None and hash_.version > 0]
