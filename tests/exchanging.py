# SPDX-License-Identifier: Apache-2.0
"""A process that exchanges actions and observations with a simulator until it is ended.

It prints, in s of the system clock, when it was ready to look for the simulator, and the first
exchange of each session.
"""
from __future__ import annotations

import sys
import time

import numpy as np
from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.wire.client import Client
from rocket_sim_node.wire.link import LinkOptions
from rocket_sim_node.wire.running import run
from rocket_sim_node.worlds import EnvironmentRestarted

IDENTITY = 7
"""the same at each start, as that of a run that is resumed"""
PERIOD = 0.001
"""s from one exchange to the next"""


def exchange(node: Node, executor: Executor) -> None:
    """Exchange for ever."""
    print(f'ready {time.time()}')
    client = Client(node, executor, LinkOptions(), IDENTITY)
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


if __name__ == '__main__':
    sys.exit(run('exchanging', exchange))
