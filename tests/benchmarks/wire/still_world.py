# SPDX-License-Identifier: Apache-2.0
"""A world with the shapes of `rocket` in which nothing moves, and a simulator of it.

It measures the cost of a lock-step exchange without physics. Run as a program it serves
the world: `python -m benchmarks.wire.still_world N [VARIANT] [--ros-args ...]`.
"""
from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs.msg import World

from benchmarks.wire.variants import VARIANTS
from rocket_sim_node import worlds
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.wire.server.server import Server
from rocket_sim_node.wire.server.server import ServerOptions
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import NO_EPISODES


class StillWorld:
    """N rockets at rest; a step costs nothing."""

    def __init__(self, num_envs: int) -> None:
        """Make the world with the shapes of `rocket`."""
        shape = worlds.make('rocket', num_envs)
        self.spec = replace(shape.spec, name='still')
        self.flown_settings = self.spec.settings
        self._observation = shape.observe()
        self._reward = np.zeros(num_envs, np.float32)
        self._flags = np.zeros(num_envs, np.bool_)
        self._info = {
            'final_rows': np.zeros(0, np.int64),
            'final_observation': self._observation[:0], 'episodes': NO_EPISODES}
        self.captured_ends, self.finished = shape.captured_ends, shape.finished
        self.capture, self.telemetry_of = shape.capture, shape.telemetry_of
        self.telemetry = shape.telemetry

    def observe(self) -> F32:
        """Return the observation."""
        return self._observation

    def reset(self, seed: int | None = None, **settings: float) -> F32:
        """Do nothing."""
        return self._observation

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Any, Any, dict[str, Any]]:
        """Do nothing."""
        return self._observation, self._reward, self._flags, self._flags, self._info

    step_checked = step

    def snapshot(self) -> bytes:
        """Return nothing."""
        return b''

    def restore(self, state: bytes) -> F32:
        """Do nothing."""
        return self._observation


def serve(node: Node, executor: Executor) -> None:
    """Serve the world until asked to stop."""
    server = Server(node, StillWorld(int(sys.argv[1])), ServerOptions(
        mode=World.LOCKSTEP, state_rows=0))
    node.get_logger().info('waiting for an agent')
    server.serve(executor)


if __name__ == '__main__':
    arguments = sys.argv[2:]
    with ExitStack() as stack:
        if arguments and arguments[0] in VARIANTS:
            variant = VARIANTS[arguments.pop(0)]
            variant.used = True
            stack.enter_context(variant.installed())
        sys.exit(run('simulator', serve, args=arguments))
