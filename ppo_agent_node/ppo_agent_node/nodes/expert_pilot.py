# SPDX-License-Identifier: Apache-2.0
"""Node `expert_pilot`: the scripted hoverslam controller, on the same topics as the agent."""
from __future__ import annotations

import sys
from dataclasses import dataclass

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.nodes.connection import EXPECTED_ERRORS
from ppo_agent_node.nodes.connection import ConnectionParameters
from ppo_agent_node.nodes.connection import level_setting
from ppo_agent_node.nodes.connection import make_client
from ppo_agent_node.nodes.flying import fly
from ppo_agent_node.nodes.flying import summary
from ppo_agent_node.pilots.expert import ExpertPilot
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.parameters import Parameters
from rocket_sim_node.wire.running import run


@dataclass(frozen=True)
class ExpertParameters:
    """Parameters of the node, beside those of the connection."""

    seed: int = setting(0, '', 'where the spawns start', 0, 2**62)
    level: int = setting(0, '', "curriculum level; 0: the simulator's own", 0, 8)
    episodes: int = setting(0, '', 'end after so many episodes; 0: never', 0, 2**31)


def pilot(node: Node, executor: Executor) -> None:
    """Fly until enough episodes have ended or ROS shuts down."""
    parameters = Parameters(node)
    options = parameters.declare(ExpertParameters)
    connection = parameters.declare(ConnectionParameters)
    parameters.finish()
    with make_client(node, executor, connection) as client:
        expert = ExpertPilot(client.connect())
        flown = fly(
            node, client, expert, options.seed, options.episodes, **level_setting(options.level))
        node.get_logger().info(summary(flown, client.spec.outcomes))


def main() -> None:
    """Run the node."""
    sys.exit(run('expert_pilot', pilot, EXPECTED_ERRORS))


if __name__ == '__main__':
    main()
