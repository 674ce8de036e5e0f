# SPDX-License-Identifier: Apache-2.0
"""A hidden node that looks at the graph, as each command that speaks DDS needs one."""
from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable
from collections.abc import Iterator
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from ros2.errors import CommandError

_SPIN_SECONDS = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that all of these commands have."""
    parser.add_argument(
        '--spin-time', type=float, default=_SPIN_SECONDS,
        help='Spin time in seconds to wait for discovery')
    parser.add_argument(
        '-s', '--use-sim-time', action='store_true', help='Enable ROS simulation time')
    parser.add_argument(
        '--no-daemon', action='store_true', help='Do not spawn nor use an already running daemon')


@contextlib.contextmanager
def direct_node(args: argparse.Namespace) -> Iterator[Node]:
    """Give a hidden node that lives as long as the command; Ctrl-C ends it quietly."""
    with rclpy.init(args=[]):
        node = rclpy.create_node(
            f'_ros2cli_{os.getpid()}', start_parameter_services=False, enable_rosout=False,
            parameter_overrides=[rclpy.Parameter('use_sim_time', value=args.use_sim_time)])
        try:
            with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
                yield node
        finally:
            node.destroy_node()


def discover(
    node: Node, args: argparse.Namespace, done: Callable[[], bool] | None = None,
) -> bool:
    """Wait until `done()`, or, without it, for the whole spin time; returns whether it is done."""
    end = time.monotonic() + args.spin_time
    while time.monotonic() < end:
        if done is not None and done():
            return True
        rclpy.spin_once(node, timeout_sec=0.02)
    return done is not None and done()


def is_hidden(name: str) -> bool:
    """Whether a part of a name begins with an underscore."""
    return any(part.startswith('_') for part in name.split('/') if part)


def node_names(node: Node, hidden: bool) -> list[str]:
    """Return the full names of all nodes, sorted, equal ones as often as they are there."""
    names = sorted(
        f'{space.rstrip("/")}/{name}' for name, space in node.get_node_names_and_namespaces())
    return [name for name in names if hidden or not is_hidden(name)]


def warn_about_duplicates(names: list[str]) -> None:
    """Say on stderr when nodes share a name."""
    if len(set(names)) < len(names):
        print('WARNING: Be aware that there are nodes in the graph that share an exact name, '
              'which can have unintended side effects.', file=sys.stderr)


def absolute(name: str) -> str:
    """Return a name with a leading slash."""
    return name if name.startswith('/') else '/' + name


def load_type(name: str, kind: str) -> Any:
    """Return the class of an interface such as std_msgs/msg/String.

    :raises CommandError: when there is none.
    """
    import importlib
    parts = name.split('/')
    if len(parts) == 2:
        parts.insert(1, kind)
    try:
        if len(parts) != 3 or parts[1] != kind or not all(parts):
            raise ValueError
        return getattr(importlib.import_module(f'{parts[0]}.{kind}'), parts[2])
    except (AttributeError, ImportError, ValueError):
        words = 'message' if kind == 'msg' else 'service'
        raise CommandError(f'The passed {words} type is invalid') from None


def topic_type(node: Node, args: argparse.Namespace, topic: str) -> Any:
    """Return the class of the messages of a topic, or None when nobody has it."""
    found: list[str] = []

    def look() -> bool:
        found[:] = dict(node.get_topic_names_and_types()).get(topic, [])
        return bool(found)

    if not discover(node, args, look):
        return None
    if len(found) > 1:
        raise CommandError(
            f"Cannot echo topic '{topic}', as it contains more than one type: "
            f"[{', '.join(found)}]")
    return load_type(found[0], 'msg')
