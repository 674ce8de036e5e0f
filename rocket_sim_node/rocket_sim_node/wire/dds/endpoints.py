# SPDX-License-Identifier: Apache-2.0
"""Names of the nodes that publish or subscribe on a topic."""
from __future__ import annotations

from typing import Any

NAMELESS = 'a participant whose node is not known'
"""How messages name a participant without a known node."""
_UNKNOWN = '_NODE_NAME_UNKNOWN_'
"""What rclpy returns until the participant has told the names of its nodes."""


def node_of(end: Any) -> str:
    """Return the full name of the node of an endpoint; empty while it is not known.

    :param end: a `TopicEndpointInfo` of rclpy.
    """
    if end.node_name == _UNKNOWN:
        return ''
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'
