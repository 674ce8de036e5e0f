# SPDX-License-Identifier: Apache-2.0
"""Calls to the parameter services of a node."""
from __future__ import annotations

import argparse
from typing import Any

import rclpy
from rclpy.node import Node

from ros2 import graph
from ros2.errors import CommandError

_SECONDS = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that the param verbs share."""
    graph.add_arguments(parser)
    parser.add_argument(
        '--include-hidden-nodes', action='store_true', help='Consider hidden nodes as well')
    parser.add_argument(
        '--timeout', metavar='N', type=float, default=1.0,
        help='Wait for N seconds until node becomes available (default 1 sec)')


def wait_for_node(node: Node, args: argparse.Namespace) -> str:
    """Return the full name of the node that the arguments name, once it is there.

    :raises CommandError: when it does not appear in time.
    """
    name = graph.absolute(args.node_name)
    args.spin_time = max(args.spin_time, args.timeout / 6.0)
    if not graph.wait_for(
            node, args, lambda: name in graph.node_names(node, args.include_hidden_nodes)):
        raise CommandError('Node not found')
    return name


def call(node: Node, kind: Any, service: str, request: Any) -> Any:
    """Return the response of a parameter service.

    :raises CommandError: when there is none in time.
    """
    client = node.create_client(kind, service)
    try:
        if client.wait_for_service(_SECONDS):
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future, timeout_sec=_SECONDS)
            if future.done():
                return future.result()
    finally:
        node.destroy_client(client)
    raise CommandError(f"Wait for service timed out waiting for '{service}'")
