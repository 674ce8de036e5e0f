# SPDX-License-Identifier: Apache-2.0
"""Mode `infer`: flies a trained policy."""
from __future__ import annotations

from dataclasses import dataclass

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.config.curriculum_config import level_setting
from ppo_agent_node.config.training_config import DEVICES
from ppo_agent_node.nodes.flights.connection import ConnectionParameters
from ppo_agent_node.nodes.flights.connection import make_client
from ppo_agent_node.nodes.flights.flying import fly
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.node.parameters import Parameters


@dataclass(frozen=True)
class InferenceParameters:
    """Parameters of mode `infer`, beside those of the connection."""

    policy: str = setting(
        '', '', 'policy file, ONNX file, or name of a shipped policy; empty: the policy of the '
        'newest finished run, or the shipped policy for the world if there is no run')
    seed: int = setting(0, '', 'seed of the starts', 0, 2**62)
    level: int = setting(0, '', "curriculum level; 0: the simulator's own", 0, 8)
    episodes: int = setting(
        0, '', 'number of episodes after which the node ends; 0: never', 0, 2**31)
    device: str = setting(
        'cpu', '', 'device on which actions are computed; auto: the GPU if there is one; an ONNX '
        'file uses the CPU', choices=DEVICES)


def infer(node: Node, executor: Executor, parameters: Parameters) -> int:
    """Fly until enough episodes have ended or ROS shuts down; return the exit status."""
    options = parameters.declare(InferenceParameters)
    connection = parameters.declare(ConnectionParameters)
    parameters.finish()
    with make_client(node, executor, connection) as client:
        spec = client.connect()
        path = find_policy(options.policy, spec.name)
        pilot = PolicyPilot(path, spec, options.device)
        node.get_logger().info(f'flying {path}')
        if pilot.unfamiliar:
            node.get_logger().warning(pilot.unfamiliar)
        fly(node, client, pilot, options.seed, options.episodes, **level_setting(options.level))
    return 0
