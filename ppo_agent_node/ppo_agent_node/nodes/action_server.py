# SPDX-License-Identifier: Apache-2.0
"""Node `action_server`: trains, evaluates and lands as actions, one goal at a time.

The processes of a goal are those of the command of the same name, in a namespace of that name
below the server's.
"""
from __future__ import annotations

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.nodes.actions.serving import Actions
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run

_SPIN_PERIOD = 0.1
"""Seconds per spin."""


def serve(node: Node, executor: Executor) -> None:
    """Serve until this process is asked to stop; a goal is stopped first, and its result sent."""
    Parameters(node).finish()
    actions = Actions(node)
    node.get_logger().info('actions train, evaluate and land are served')
    try:
        while actions.busy or not stopping.requested():
            executor.spin_once(timeout_sec=_SPIN_PERIOD)
            actions.poll()
    finally:
        actions.close(executor)


def main() -> None:
    """Run the node."""
    leave(run('action_server', serve, expected=(ParameterError,)))


if __name__ == '__main__':
    main()
