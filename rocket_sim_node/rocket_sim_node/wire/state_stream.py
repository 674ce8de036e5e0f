# SPDX-License-Identifier: Apache-2.0
"""The topic `state`: full states of the first few rockets, several steps to a message."""
from __future__ import annotations

import numpy as np
from rclpy.node import Node
from rocket_msgs.msg import RocketState

from rocket_sim_node.wire import messages
from rocket_sim_node.wire import qos
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.base import Telemetry


class StateStream:
    """Publishes every step of the first `rows` rockets, `batch` steps to a message.

    Costs nothing while nobody listens. In lock-step thousands of steps pass in a second, so a
    message for each would slow down those who train; gathered, each step is still there.
    """

    def __init__(self, node: Node, world: SimulatedWorld, rows: int, batch: int) -> None:
        """Advertise the topic; no rows, no messages."""
        self._world = world
        self._count = min(rows, world.spec.num_envs)
        self._rows = slice(0, self._count)
        self._batch = batch
        self._parts: list[tuple[int, Telemetry]] = []
        self._session = 0
        self._publisher = node.create_publisher(RocketState, 'state', qos.EVENTS)
        self._listened = False

    def add(self, session: int, step: int) -> None:
        """Take the present states, and before them the last ones of those that finished."""
        if not self._count:
            return
        if step % self._batch == 0 or not self._listened:
            # Asking costs as much as a step's bookkeeping, hence once a batch.
            self._listened = (
                step % self._batch == 0 and self._publisher.get_subscription_count() > 0)
        if not self._listened:
            return
        self._session = session
        finished = self._world.finished
        ended = np.flatnonzero(finished.row < self._count)
        if ended.size:
            self._parts.append((step, finished.take(ended)))
        self._parts.append((step, self._world.telemetry(self._rows)))
        if step % self._batch == self._batch - 1:
            self.flush()

    def flush(self) -> None:
        """Publish what has been gathered."""
        if self._parts:
            self._publisher.publish(messages.state_to_message(self._parts, self._session))
            self._parts = []
