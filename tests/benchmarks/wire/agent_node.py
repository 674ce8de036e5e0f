# SPDX-License-Identifier: Apache-2.0
"""A node for benchmarks, with the same transport as the nodes of a training."""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier

from rocket_sim_node.wire.dds.transport import prepared
from rocket_sim_node.wire.node.running import make_executor


@contextmanager
def agent_node(
    name: str, domain: int | None = None, namespace: str | None = None,
) -> Iterator[tuple[Node, Executor]]:
    """Yield a node with its own context, and its executor."""
    context = Context()
    with ExitStack() as stack:
        with prepared(get_rmw_implementation_identifier()):
            rclpy.init(context=context, domain_id=domain)
            stack.callback(rclpy.try_shutdown, context=context)
            node = rclpy.create_node(name, namespace=namespace, context=context)
        stack.callback(node.destroy_node)
        executor = make_executor(context)
        stack.callback(executor.shutdown)
        executor.add_node(node)
        yield node, executor
