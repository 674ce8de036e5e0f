# SPDX-License-Identifier: Apache-2.0
"""A hidden node that looks at the graph, as each command that speaks DDS needs one."""
from __future__ import annotations

import contextlib
import importlib
import os
import sys
import time
from collections.abc import Callable
from collections.abc import Iterator
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from ros2.errors import CommandError

_SPIN_SECONDS = 0.5
_QUIET_SECONDS = 0.2


@contextlib.contextmanager
def direct_node(signals: SignalHandlerOptions = SignalHandlerOptions.ALL) -> Iterator[Node]:
    """Give a hidden node that lives as long as the command; Ctrl-C ends it quietly.

    It is as secure as the nodes are and reaches as far, or the command ends with status 2.

    :param signals: those that rclpy handles; it shuts the node's context down at once.
    """
    try:
        from rocket_sim_node.wire.dds import security
        from rocket_sim_node.wire.dds import transport
        from rocket_sim_node.wire.dds.profile import ProfileError
        from rocket_sim_node.wire.distributions import initialised
    except ImportError as error:
        raise CommandError(
            f'{error}; enter the environment first: . launch_scripts/env.sh') from None
    with contextlib.ExitStack() as stack:
        try:
            security.require('ros2', [])
            with transport.prepared(get_rmw_implementation_identifier()):
                stack.enter_context(initialised(args=[], signal_handler_options=signals))
                node = rclpy.create_node(
                    f'_ros2cli_{os.getpid()}', start_parameter_services=False,
                    enable_rosout=False)
        except (ProfileError, transport.TransportError, security.SecurityError) as error:
            print(f'ros2: {error}', file=sys.stderr)
            raise SystemExit(2) from None
        try:
            with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
                yield node
        finally:
            node.destroy_node()


def wait_for(node: Node, done: Callable[[], bool]) -> bool:
    """Wait until `done()`, for six spin times at most; returns whether it is.

    There is no daemon that knows the graph already, and a loaded machine discovers slowly.
    """
    end = time.monotonic() + 6.0 * _SPIN_SECONDS
    while not done():
        if time.monotonic() > end:
            return False
        rclpy.spin_once(node, timeout_sec=0.02)
    return True


def look_around(node: Node) -> None:
    """Wait for the spin time, longer while the graph still changes or is empty."""
    start = changed = time.monotonic()
    graph: list[Any] = []
    while True:
        rclpy.spin_once(node, timeout_sec=0.02)
        now = time.monotonic()
        seen = [node.get_node_names_and_namespaces(), node.get_topic_names_and_types()]
        if seen != graph:
            graph, changed = seen, now
        seconds = _SPIN_SECONDS * (3.0 if len(seen[0]) < 2 else 1.0)
        if now - start > seconds and now - changed > _QUIET_SECONDS:
            return


def is_hidden(name: str) -> bool:
    """Whether a part of a name begins with an underscore."""
    return any(part.startswith('_') for part in name.split('/') if part)


def node_names(node: Node) -> list[str]:
    """Return the full names of the nodes, sorted, equal ones as often as they are there.

    Hidden nodes, such as our own, are left out.
    """
    names = sorted(
        f'{space.rstrip("/")}/{name}' for name, space in node.get_node_names_and_namespaces())
    return [name for name in names if not is_hidden(name)]


def absolute(name: str) -> str:
    """Return a name with a leading slash."""
    return name if name.startswith('/') else '/' + name


def load_type(name: str, kind: str) -> Any:
    """Return the class of an interface such as std_msgs/msg/String.

    :raises CommandError: when there is none.
    """
    parts = name.split('/')
    if len(parts) == 2:
        parts.insert(1, kind)
    try:
        if len(parts) != 3 or parts[1] != kind or not all(parts):
            raise ValueError
        return getattr(importlib.import_module(f'{parts[0]}.{kind}'), parts[2])
    except (AttributeError, ImportError, ValueError):
        words = {'msg': 'message', 'srv': 'service'}
        raise CommandError(f'The passed {words.get(kind, kind)} type is invalid') from None
