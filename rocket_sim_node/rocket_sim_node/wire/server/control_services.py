# SPDX-License-Identifier: Apache-2.0
"""Services by which an agent takes, copies and leaves a simulator, below the node's name.

Before 1.0 their names were beside the node: `/reset` instead of `/simulator/reset`. The old names
still answer, with a warning.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from typing import Any
from typing import TypeAlias

from rclpy.node import Node
from rclpy.service import Service

from rocket_sim_node.wire.node.request_sender import RequestSender

Handler: TypeAlias = Callable[[Any, Any, bytes], Any]
"""Called with request, response and the GID of the client, which is empty if it is not known;
returns the response."""


class ControlServices:
    """The services of a simulator, each by its name and by its deprecated one."""

    def __init__(
        self, node: Node, own: bytes, offered: Sequence[tuple[Any, str, Handler]],
    ) -> None:
        """Create them.

        :param own: the participant of this node.
        :param offered: type, name below the node's and handler of each.
        """
        self._node, self._own = node, own
        self._names: dict[str, tuple[str, str]] = {}
        self.current: list[Service] = []
        """Services by their names."""
        self.deprecated: list[Service] = []
        """Services by their names of before 1.0."""
        for kind, name, handler in offered:
            short = name.removeprefix('~/')
            service = self._create(kind, name, handler)
            before = self._create(kind, short, handler, service.service_name)
            self.current.append(service)
            self.deprecated.append(before)
            self._names[short] = service.service_name, before.service_name

    def _create(self, kind: Any, name: str, handler: Handler, successor: str = '') -> Service:
        """Create one service.

        :param successor: the name to be used instead; empty: this one is not deprecated.
        """
        warned = not successor

        def answer(request: Any, response: Any) -> Any:
            nonlocal warned
            if not warned:
                warned = True
                self._node.get_logger().warning(
                    f'service {service.service_name} is deprecated and will be removed in 2.0: '
                    f'call {successor}')
            return handler(request, response, sender.take())

        service = self._node.create_service(kind, name, answer)
        sender = RequestSender(self._node, service, kind, self._own)
        return service

    def names(self, name: str) -> tuple[str, str]:
        """Return the full names of a service, such as `reset`: the present and the deprecated one.

        The agent in control may have its client on one of them, and another process may call the
        other one in its name.
        """
        return self._names[name]
