# SPDX-License-Identifier: Apache-2.0
"""Messages with the result of a step, kept so that they can be published again."""
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Episodes


class ResultPublisher:
    """Publishes `observation`, `reward` and `episodes` of the last step, any number of times."""

    def __init__(self, node: Node) -> None:
        """Create the publishers."""
        self._publishers = {}
        self._codecs = {}
        for kind, topic, profile in (
            (msg.Episodes, 'episodes', qos.EVENTS), (msg.Reward, 'reward', qos.STREAM),
            (msg.Observation, 'observation', qos.STREAM),
        ):
            self._publishers[topic] = node.create_publisher(kind, topic, profile)
            self._codecs[topic] = Codec(kind)
        self._messages: dict[str, bytes] = {}

    def fill_first(self, session: int, observation: F32) -> None:
        """Store the first observation of a session, which no action led to."""
        none = np.zeros(len(observation), np.bool_)
        self.fill(session, 0, observation, none.astype(np.float32), none, none, {
            'final_rows': none[:0], 'final_observation': none[:0], 'episodes': ()})

    def fill(
        self, session: int, step: int, observation: F32, reward: F32, terminated: Bools,
        truncated: Bools, info: dict[str, Any],
    ) -> None:
        """Store what a world's step returned."""
        numbers = (session, step)
        episodes: Episodes = info['episodes']
        arrays: dict[str, Sequence[NDArray[Any]]] = {
            'observation': (observation,),
            'reward': (reward, terminated, truncated, info['final_rows'],
                       info['final_observation'])}
        if len(episodes):
            arrays['episodes'] = conversion.episode_arrays(episodes)
        self._messages = {
            topic: self._codecs[topic].encode(numbers, found) for topic, found in arrays.items()}

    def publish(self) -> None:
        """Publish the stored messages, the observation first: the agent acts on it."""
        for topic, message in self._messages.items():
            self._publishers[topic].publish(message)
