# SPDX-License-Identifier: Apache-2.0
"""Identity of the client whose request a service is handling.

rclpy does not pass on who called a service. The introspection of services does: a service can
publish an event, with the GID of the client, for each request that it takes
(`rclpy.service.Service.configure_introspection`). DDS delivers it within the process before the
service's callback runs, so the service learns the caller from its own event.
"""
from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from service_msgs.msg import ServiceEventInfo

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.peer import participant_of
from rocket_sim_node.wire.node.polling import MessageSubscription


class RequestSender:
    """Tells, within the callback of a service, whose request that is."""

    def __init__(self, node: Node, service: Service, kind: Any, own: bytes) -> None:
        """Let the service report its requests, where the sender of a message can be told.

        :param kind: of the service.
        :param own: the participant of this node; reports of others are left out.
        """
        self._own = own
        self._events = MessageSubscription(
            node, kind.Event, f'{service.service_name}/_service_event', qos.REQUESTS)
        if self._events.handle is not None:
            service.configure_introspection(
                node.get_clock(), qos.REQUESTS, ServiceIntrospectionState.METADATA)

    def take(self) -> bytes:
        """Return the GID of the client of the latest request; empty if it is not known."""
        found = b''
        while (taken := self._events.take()) is not None:
            event, sender = taken
            if self._own and participant_of(sender) == self._own and (
                    event.info.event_type == ServiceEventInfo.REQUEST_RECEIVED):
                found = bytes(event.info.client_gid)
        return found
