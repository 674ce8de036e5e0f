# SPDX-License-Identifier: Apache-2.0
"""Node `ppo_agent`: trains a policy in a simulator, or flies a trained one."""
from __future__ import annotations

from dataclasses import dataclass

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.nodes.connection import EXPECTED_ERRORS
from ppo_agent_node.nodes.inference import infer
from ppo_agent_node.nodes.training import train
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.parameters import Parameters
from rocket_sim_node.wire.running import leave
from rocket_sim_node.wire.running import run

_MODES = {'train': train, 'infer': infer}


@dataclass(frozen=True)
class AgentParameters:
    """What the node does; further parameters depend on it."""

    mode: str = setting('train', '', 'train a policy, or fly one', choices=tuple(_MODES))


def agent(node: Node, executor: Executor) -> int:
    """Do what the parameters say."""
    parameters = Parameters(node)
    return _MODES[parameters.declare(AgentParameters).mode](node, executor, parameters)


def main() -> None:
    """Run the node."""
    leave(run('ppo_agent', agent, EXPECTED_ERRORS))


if __name__ == '__main__':
    main()
