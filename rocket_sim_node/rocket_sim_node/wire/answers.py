# SPDX-License-Identifier: Apache-2.0
"""The answer of a step, put together from the topics that it comes on, and checked."""
from __future__ import annotations

from typing import Any

import numpy as np
from rocket_msgs import msg

from rocket_sim_node.wire import messages
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec


class Answers:
    """Takes `observation`, `reward` and `episodes` of the step that is awaited; drops all else."""

    def __init__(self) -> None:
        """Await nothing."""
        self._spec: WorldSpec | None = None
        self._session = self._step = 0
        self._realtime = False
        self._observation: msg.Observation | None = None
        self._reward: msg.Reward | None = None
        self._episodes: msg.Episodes | None = None

    def expect(self, spec: WorldSpec) -> None:
        """Say which world answers."""
        self._spec = spec

    def await_step(self, session: int, step: int, realtime: bool) -> None:
        """Wait for the answer to an action of this session and step; drop what there was.

        :param realtime: any later step will do.
        """
        self._session, self._step, self._realtime = session, step, realtime
        self._observation = self._reward = self._episodes = None

    def on_observation(self, message: msg.Observation) -> None:
        """Take a message of the topic."""
        if self._is_awaited(message):
            self._observation = message

    def on_reward(self, message: msg.Reward) -> None:
        """Take a message of the topic."""
        if self._is_awaited(message):
            self._reward = message

    def on_episodes(self, message: msg.Episodes) -> None:
        """Take a message of the topic."""
        if self._is_awaited(message):
            self._episodes = message

    def _is_awaited(self, message: Any) -> bool:
        if message.session != self._session:
            return False
        if self._realtime:
            return bool(message.step > self._step)
        return bool(message.step == self._step + 1)

    @property
    def complete(self) -> bool:
        """Whether all that belongs to the step has come, the episodes that ended included."""
        if self._observation is None or self._reward is None:
            return False
        step = self._reward.step
        if self._observation.step != step:
            return False
        return not len(self._reward.final_rows) or (
            self._episodes is not None and self._episodes.step == step)

    def take(self) -> tuple[int, tuple[Any, ...]]:
        """Return the step reached and what `VectorEnv.step` answers.

        :raises ValueError: naming topic, field, what came and what was expected.
        """
        spec, reward, observed = self._spec, self._reward, self._observation
        assert spec is not None and reward is not None and observed is not None
        _check(spec, observed, reward)
        observation = messages.from_sequence(observed.data, 'f4').reshape(
            spec.num_envs, spec.observation_size)
        finished = messages.from_sequence(reward.final_rows, 'u4').astype(np.int64)
        episodes: Episodes = NO_EPISODES
        if finished.size and self._episodes is not None:
            episodes = messages.episodes_from_message(self._episodes)
        info = {
            'final_rows': finished,
            'final_observation': messages.from_sequence(reward.final_observation, 'f4').reshape(
                len(finished), spec.observation_size),
            'episodes': episodes,
        }
        self._observation = self._reward = self._episodes = None
        return reward.step, (
            observation, messages.from_sequence(reward.reward, 'f4'),
            messages.from_sequence(reward.terminated, 'u1').view(np.bool_),
            messages.from_sequence(reward.truncated, 'u1').view(np.bool_), info,
        )


def _check(spec: WorldSpec, observation: msg.Observation, reward: msg.Reward) -> None:
    """Check what came from the far end before anything is learnt from it.

    :raises ValueError: naming topic, field, what came and what was expected.
    """
    finished = len(reward.final_rows)
    for where, values, expected in (
        ('observation: data', observation.data, spec.num_envs * spec.observation_size),
        ('reward: reward', reward.reward, spec.num_envs),
        ('reward: terminated', reward.terminated, spec.num_envs),
        ('reward: truncated', reward.truncated, spec.num_envs),
        ('reward: final_observation', reward.final_observation,
         finished * spec.observation_size),
    ):
        if len(values) != expected:
            raise ValueError(f'{where}: {len(values)} values, expected {expected}')
    if finished and max(reward.final_rows) >= spec.num_envs:
        raise ValueError(
            f'reward: final_rows: {max(reward.final_rows)}, expected less than {spec.num_envs}')
    for where, values in (
            ('observation: data', observation.data), ('reward: reward', reward.reward)):
        if not np.isfinite(messages.from_sequence(values, 'f4')).all():
            raise ValueError(f'{where}: a value that is not finite')
