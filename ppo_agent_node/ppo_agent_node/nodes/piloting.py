# SPDX-License-Identifier: Apache-2.0
"""Nodes that fly a pilot that does not learn, on the same topics as the agent."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.config.curriculum_config import level_setting
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.nodes.flights.connection import EXPECTED_ERRORS
from ppo_agent_node.nodes.flights.connection import ConnectionParameters
from ppo_agent_node.nodes.flights.connection import make_client
from ppo_agent_node.nodes.flights.flying import fly
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.worlds import WorldSpec


@dataclass(frozen=True)
class PilotParameters:
    """Parameters of a pilot's node, beside those of the connection."""

    seed: int = setting(0, '', "seed of the starts and of the pilot's random numbers", 0, 2**62)
    level: int = setting(0, '', "curriculum level; 0: the simulator's own", 0, 8)
    episodes: int = setting(
        0, '', 'number of episodes after which the node ends; 0: never', 0, 2**31)


def run_pilot(name: str, make: Callable[[WorldSpec, int], Pilot]) -> int:
    """Run the node until enough episodes have ended or ROS shuts down; return the exit status.

    :param make: creates the pilot for a world and a seed.
    """
    def pilot(node: Node, executor: Executor) -> None:
        parameters = Parameters(node)
        options = parameters.declare(PilotParameters)
        connection = parameters.declare(ConnectionParameters)
        parameters.finish()
        with make_client(node, executor, connection) as client:
            fly(node, client, make(client.connect(), options.seed), options.seed,
                options.episodes, **level_setting(options.level))

    return run(name, pilot, EXPECTED_ERRORS)
