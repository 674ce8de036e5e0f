# SPDX-License-Identifier: Apache-2.0
"""The answer of a step, put together from the topics that it comes on, and checked."""
from __future__ import annotations

import math
from typing import Any

import numpy as np

from rocket_sim_node.wire import messages
from rocket_sim_node.wire.inbox import Mailbox
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec


class Answers:
    """Collects `observation`, `reward` and `episodes` of the step awaited; drops all else."""

    def __init__(self, observation: Mailbox, reward: Mailbox, episodes: Mailbox) -> None:
        """Await nothing."""
        self._boxes = (observation, reward, episodes)
        self._spec: WorldSpec | None = None
        self._session = self._step = 0
        self._realtime = False
        self._observation: Any = None
        self._reward: Any = None
        self._episodes: Any = None

    def expect(self, spec: WorldSpec) -> None:
        """Say which world answers."""
        self._spec = spec

    def await_step(self, session: int, step: int, realtime: bool) -> None:
        """Wait for the answer to an action of this session and step; drop what there was.

        :param realtime: any later step will do.
        """
        self._session, self._step, self._realtime = session, step, realtime
        self._observation = self._reward = self._episodes = None

    @property
    def missing(self) -> Mailbox | None:
        """Where something is to come before the answer is complete; None when it is.

        The simulator sends the observation last: who has it mostly has all the rest already.
        """
        observation, reward, episodes = self._boxes
        if self._observation is None:
            return observation
        step = self._observation.step
        if self._reward is None or self._reward.step < step:
            return reward
        if self._reward.step > step:
            return observation
        if len(self._reward.final_rows) and (
                self._episodes is None or self._episodes.step < step):
            return episodes
        return None

    def collect(self) -> bool:
        """Take what has come; tell whether the answer is complete.

        :raises ValueError: for bytes that are no message.
        """
        while (box := self.missing) is not None:
            message = box.take()
            if message is None:
                return False
            if not self._is_awaited(message):
                continue
            if box is self._boxes[0]:
                self._observation = message
            elif box is self._boxes[1]:
                self._reward = message
            else:
                self._episodes = message
        return True

    def _is_awaited(self, message: Any) -> bool:
        if message.session != self._session:
            return False
        if self._realtime:
            return bool(message.step > self._step)
        return bool(message.step == self._step + 1)

    def take(self) -> tuple[int, tuple[Any, ...]]:
        """Return the step reached and what `VectorEnv.step` answers.

        :raises ValueError: naming topic, field, what came and what was expected.
        """
        spec, reward, observed = self._spec, self._reward, self._observation
        assert spec is not None and reward is not None and observed is not None
        _check(spec, observed, reward)
        observation = observed.data.reshape(spec.num_envs, spec.observation_size)
        finished = reward.final_rows.astype(np.int64)
        episodes: Episodes = NO_EPISODES
        if finished.size and self._episodes is not None:
            episodes = messages.episodes_from_message(self._episodes)
        info = {
            'final_rows': finished,
            'final_observation': reward.final_observation.reshape(
                len(finished), spec.observation_size),
            'episodes': episodes,
        }
        self._observation = self._reward = self._episodes = None
        return reward.step, (
            observation, reward.reward, reward.terminated.view(np.bool_),
            reward.truncated.view(np.bool_), info,
        )


def _check(spec: WorldSpec, observation: Any, reward: Any) -> None:
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
        # A sum is quicker than to look at each; where it overflows, each is looked at.
        if not math.isfinite(np.add.reduce(values)) and not np.isfinite(values).all():
            raise ValueError(f'{where}: a value that is not finite')
