# SPDX-License-Identifier: Apache-2.0
"""Publisher of `state`: full states of the first few rockets, several steps per message."""
from __future__ import annotations

import numpy as np
from rclpy.node import Node
from rocket_msgs.msg import RocketState

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import SimulatedWorld


class StateStream:
    """Publishes every step of the first `rows` rockets, `batch` steps per message.

    Costs nothing without subscribers. In lock-step there are thousands of steps per second, and a
    message for each would slow down training; batching keeps every step.
    """

    def __init__(self, node: Node, world: SimulatedWorld, rows: int, batch: int) -> None:
        """Create the publisher; without rows nothing is published."""
        self._world = world
        self._count = rows
        self._rows = slice(0, rows)
        self._batch = batch
        self._captured: list[F64] = []
        self._steps: list[int] = []
        self._session = self._time = 0
        self._publisher = node.create_publisher(RocketState, 'state', qos.EVENTS)
        self._listened = False

    def add(self, session: int, step: int, time: int) -> None:
        """Add the current states, preceded by the final states of rockets that finished.

        :param time: simulated time, ns.
        """
        place = step % self._batch
        if place == 0 or not self._listened:
            # Counting subscribers costs as much as a step's bookkeeping, hence once per batch.
            self._listened = (
                place == 0 and self._count > 0 and self._publisher.get_subscription_count() > 0)
            if not self._listened:
                return
        self._session, self._time = session, time
        ends = self._world.captured_ends
        if ends.size:
            self._keep(step, ends[:, ends[0] < self._count])
        self._keep(step, self._world.capture(self._rows))
        if place == self._batch - 1:
            self.flush()

    def _keep(self, step: int, captured: F64) -> None:
        self._captured.append(captured)
        self._steps.append(step)

    def flush(self) -> None:
        """Publish the collected samples."""
        if not self._captured:
            return
        step = np.repeat(
            np.array(self._steps, np.uint64), [part.shape[1] for part in self._captured])
        telemetry = self._world.telemetry_of(np.concatenate(self._captured, axis=1))
        self._publisher.publish(conversion.state_to_message(
            step, telemetry, self._session, self._time))
        self._captured.clear()
        self._steps.clear()
