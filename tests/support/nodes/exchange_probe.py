# SPDX-License-Identifier: Apache-2.0
"""A process that exchanges actions and observations with a simulator until it is ended.

It prints the times, in s of the system clock, when it begins to look for the simulator and of the
first exchange of each session. It starts like `ppo_agent`, with the same imports.
"""
from __future__ import annotations

import importlib
import sys
import time

from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.wire.node.running import Body
from rocket_sim_node.wire.node.running import Errors
from rocket_sim_node.wire.node.running import run_late

IDENTITY = 7
"""the same at each start, like the identity of a resumed run"""
PERIOD = 0.001
"""s from one exchange to the next"""


def load() -> tuple[Body, Errors]:
    """Import the modules of an agent, and return a function that exchanges until it is ended."""
    import numpy as np

    importlib.import_module('ppo_agent_node.nodes.agent.modes')
    from rocket_sim_node.wire.client.client import Client
    from rocket_sim_node.wire.client.connection import ConnectionOptions
    from rocket_sim_node.worlds import EnvironmentRestarted

    def exchange(node: Node, executor: Executor) -> None:
        print(f'ready {time.time()}')
        client = Client(node, executor, ConnectionOptions(), IDENTITY)
        while True:
            try:
                client.reset(1)
                action = np.zeros((client.spec.num_envs, client.spec.action_size), np.float32)
                client.step(action)
                print(f'exchange {time.time()}')
                while True:
                    time.sleep(PERIOD)
                    client.step(action)
            except EnvironmentRestarted:
                continue

    return exchange, ()


if __name__ == '__main__':
    sys.exit(run_late('exchanging', load))
