# SPDX-License-Identifier: Apache-2.0
"""What a step brought, as messages that are kept: to publish it, and to publish it again."""
from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.wire import messages
from rocket_sim_node.wire import qos
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec


class ResultPublisher:
    """Publishes `observation`, `reward` and `episodes` of the last step, any number of times."""

    def __init__(self, node: Node, spec: WorldSpec) -> None:
        """Advertise the topics and size the messages for a world."""
        self._observation = msg.Observation()
        self._reward = msg.Reward()
        self._episodes: msg.Episodes | None = None
        self._observation_view = messages.shared_view(
            self._observation, 'data', spec.num_envs * spec.observation_size, 'f4')
        self._reward_view, self._terminated_view, self._truncated_view = (
            messages.shared_view(self._reward, field, spec.num_envs, kind)
            for field, kind in (('reward', 'f4'), ('terminated', 'u1'), ('truncated', 'u1')))
        self._observation_publisher = node.create_publisher(
            msg.Observation, 'observation', qos.STREAM)
        self._reward_publisher = node.create_publisher(msg.Reward, 'reward', qos.STREAM)
        self._episodes_publisher = node.create_publisher(msg.Episodes, 'episodes', qos.EVENTS)

    def fill_first(self, session: int, observation: F32) -> None:
        """Take the first observation of a session, which no action led to."""
        none = np.zeros(len(self._reward_view), np.bool_)
        self.fill(session, 0, observation, none.astype(np.float32), none, none, {
            'final_rows': none[:0], 'final_observation': none[:0], 'episodes': ()})

    def fill(
        self, session: int, step: int, observation: F32, reward: F32, terminated: Bools,
        truncated: Bools, info: dict[str, Any],
    ) -> None:
        """Take what a world's step returned."""
        for message in (self._observation, self._reward):
            message.session = session
            message.step = step
        self._observation_view[:] = observation.ravel()
        self._reward_view[:] = reward
        self._terminated_view[:] = terminated
        self._truncated_view[:] = truncated
        self._reward.final_rows = messages.to_sequence(info['final_rows'], 'u4')
        self._reward.final_observation = messages.to_sequence(info['final_observation'], 'f4')
        episodes: Episodes = info['episodes']
        self._episodes = messages.episodes_to_message(
            episodes, session, step) if len(episodes) else None

    def publish(self) -> None:
        """Publish what was taken; the observation last: who has it has all the rest already."""
        if self._episodes is not None:
            self._episodes_publisher.publish(self._episodes)
        self._reward_publisher.publish(self._reward)
        self._observation_publisher.publish(self._observation)
