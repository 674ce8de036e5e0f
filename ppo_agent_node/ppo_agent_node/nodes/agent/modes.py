# SPDX-License-Identifier: Apache-2.0
"""Dispatch of node `ppo_agent` to its mode: training or inference."""
from __future__ import annotations

from dataclasses import dataclass

from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.settings import setting
from rocket_sim_node.wire.node.parameters import Parameters

_MODES = ('train', 'infer')


@dataclass(frozen=True)
class AgentParameters:
    """Mode of the node; further parameters depend on it."""

    mode: str = setting(
        'train', '', 'train: train a policy; infer: fly one', choices=_MODES)


def act(node: Node, executor: Executor) -> int:
    """Run the mode that the parameters select."""
    parameters = Parameters(node)
    # Imported here: a training needs PyTorch, and the flight of an ONNX file does not.
    if parameters.declare(AgentParameters).mode == 'train':
        from ppo_agent_node.nodes.agent.training import train
        return train(node, executor, parameters)
    from ppo_agent_node.nodes.agent.inference import infer
    return infer(node, executor, parameters)
