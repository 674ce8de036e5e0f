# SPDX-License-Identifier: Apache-2.0
"""Publishes invalid messages, and receives the diagnostics of the simulator."""
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rocket_msgs import msg

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion


class Speaker:
    """Publishes invalid messages, and receives the diagnostics of the simulator."""

    def __init__(self, client: Client) -> None:
        self.client = client
        node = client.node
        self.publisher = node.create_publisher(msg.Action, 'action', qos.STREAM)
        self.heard: list[tuple[int, int]] = []
        self.diagnostics: list[str] = []
        self.subscriptions = [
            node.create_subscription(
                msg.Observation, 'observation',
                lambda m: self.heard.append((m.session, m.step)), qos.STREAM),
            node.create_subscription(
                DiagnosticArray, '/diagnostics',
                lambda m: self.diagnostics.append(m.status[0].message), qos.EVENTS),
        ]
        assert client.waiter.until(
            lambda: self.publisher.get_subscription_count() > 0
            and node.count_publishers('/diagnostics') > 1, 10.0)

    def say(self, values: np.ndarray, **fields: int) -> None:
        """Publish an action, by default a good one for the present step."""
        connection = self.client.connection
        message = msg.Action(**{
            'session': connection.session, 'step': connection.step,
            'agent': connection.agent, **fields})
        message.continuous = conversion.to_sequence(values, 'f4')
        self.said = message
        self.publisher.publish(message)

    def insist(self, done: Callable[[], bool]) -> None:
        """Wait until `done()`; repeat messages that were lost before discovery was complete."""
        for _ in range(10):
            if self.client.waiter.until(done, 2.0):
                return
            self.publisher.publish(self.said)
        raise AssertionError(f'heard {self.heard}, diagnostics {self.diagnostics}')

    def expect_refusal(self, *words: str) -> None:
        """Wait for diagnostics that name all of the words."""
        self.insist(lambda: any(all(w in text for w in words) for text in self.diagnostics))
