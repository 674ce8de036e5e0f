# SPDX-License-Identifier: Apache-2.0
"""Dispatch of node `ppo_agent` to its mode: training or inference."""
from __future__ import annotations

from dataclasses import dataclass

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.nodes.agent.inference import infer
from ppo_agent_node.nodes.agent.training import train
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.node.parameters import Parameters

_MODES = {'train': train, 'infer': infer}


@dataclass(frozen=True)
class AgentParameters:
    """Mode of the node; further parameters depend on it."""

    mode: str = setting('train', '', 'train a policy, or fly one', choices=tuple(_MODES))


def act(node: Node, executor: Executor) -> int:
    """Run the mode that the parameters select."""
    parameters = Parameters(node)
    return _MODES[parameters.declare(AgentParameters).mode](node, executor, parameters)
