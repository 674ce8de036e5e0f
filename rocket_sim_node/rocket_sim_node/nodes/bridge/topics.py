# SPDX-License-Identifier: Apache-2.0
"""Topics whose messages are built only if someone would receive them."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from rocket_sim_node.wire.dds import qos

if TYPE_CHECKING:  # it needs foxglove-sdk
    from rocket_sim_node.nodes.bridge.foxglove_server import FoxgloveServer


@dataclass(frozen=True)
class Outlet:
    """One way in which the messages of a topic leave the process."""

    send: Callable[[Any], None]
    """Sends a message."""
    wanted: Callable[[], bool]
    """Returns whether anyone would receive it."""


class Topic:
    """One topic: a publisher of ROS, and Foxglove's if the node serves it.

    On a latched topic every message is sent, for those who subscribe later.
    """

    def __init__(self, outlets: tuple[Outlet, ...], latched: bool) -> None:
        """Send messages by these outlets."""
        self._outlets, self._latched = outlets, latched

    def publish(self, build: Callable[..., Any], *values: Any) -> None:
        """Publish `build(*values)`."""
        chosen = [outlet for outlet in self._outlets if self._latched or outlet.wanted()]
        if chosen:
            message = build(*values)
            for outlet in chosen:
                outlet.send(message)


class Topics:
    """Creates the topics of a node."""

    def __init__(self, node: Node, foxglove: FoxgloveServer | None = None) -> None:
        """Publish by a node, and by a server if there is one."""
        self._node, self._foxglove = node, foxglove

    def open(self, kind: Any, topic: str, profile: QoSProfile) -> Topic:
        """Create a topic."""
        latched = profile is qos.LATCHED
        publisher = self._node.create_publisher(kind, topic, profile)
        outlets = [Outlet(publisher.publish, lambda: publisher.get_subscription_count() > 0)]
        if self._foxglove is not None:
            outlets.append(self._foxglove.topic(
                kind, self._node.resolve_topic_name(topic), latched))
        return Topic(tuple(outlets), latched)

    def set_time(self, stamp: int) -> None:
        """Tell the simulated time, ns, of the messages that follow."""
        if self._foxglove is not None:
            self._foxglove.set_time(stamp)
