# SPDX-License-Identifier: Apache-2.0
"""Assembly and validation of a step's answer from the topics it arrives on."""
from __future__ import annotations

import functools
from collections.abc import Callable
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import Results

Step = tuple[F32, F32, Bools, Bools, dict[str, Any]]
"""The return value of `VectorEnv.step`."""


class Answers:
    """Collects `observation`, `reward` and `episodes` of the awaited step; drops all else."""

    def __init__(
        self, subscriptions: Sequence[ArraySubscription], warn: Callable[[str], None],
        accepts: Callable[[ArraySubscription], bool] = lambda subscription: True,
    ) -> None:
        """Set up without awaiting a step.

        :param subscriptions: those of observation, reward and episodes.
        :param warn: called with a text for each message that could not be decoded.
        :param accepts: called with the subscription of each message of the session; returns
            whether the simulator sent it.
        """
        self._warn, self._accepts = warn, accepts
        self._subscriptions = tuple(subscriptions)
        self._spec: WorldSpec | None = None
        self._session = self._step = 0
        self._early = False
        """Whether the observation is awaited first."""
        self.ahead = 0
        """Step that the simulator is at, when that is beyond the answer that is awaited."""
        self._observation: Any = None
        self._reward: Any = None
        self._episodes: Any = None

    def expect(self, spec: WorldSpec) -> None:
        """Set the world whose answers are expected."""
        self._spec = spec

    def await_step(self, session: int, step: int, early: bool = False) -> None:
        """Start to wait for the answer to this session and step; drop what came before.

        :param early: whether the observation is of use before the rest has arrived.
        """
        self._session, self._step, self.ahead, self._early = session, step, 0, early
        self._observation = self._reward = self._episodes = None

    @property
    def awaited_step(self) -> int:
        """The step of the answer that is awaited."""
        return self._step + 1

    @property
    def missing(self) -> ArraySubscription | None:
        """The subscription of the next missing part; None when the answer is complete.

        The simulator sends the observation first, so with the reward both are here. To wait for
        each would wake the agent twice.
        """
        observation, reward, episodes = self._subscriptions
        if self._observation is None and (self._early or self._reward is not None):
            return observation
        if self._reward is None:
            return reward
        return episodes if self._episodes is None and len(self._reward.final_rows) else None

    def collect(self) -> bool:
        """Read the messages that have arrived; return whether the answer is complete.

        Messages of another session or step are skipped.
        """
        while (subscription := self.missing) is not None:
            message = self._next(subscription)
            if message is None:
                return False
            if not self._is_awaited(message):
                if message.session == self._session and message.step > self._step + 1:
                    self.ahead = message.step
                continue
            if subscription is self._subscriptions[0]:
                self._observation = message
            elif subscription is self._subscriptions[1]:
                self._reward = message
            else:
                self._episodes = message
        return True

    def observe(self) -> bool:
        """Read the messages that have arrived; return whether the observation is among them."""
        return self.collect() or self._observation is not None

    def heard_of(self, session: int) -> bool:
        """Read the observations that have arrived; return whether one belongs to this session."""
        heard = False
        while (message := self._next(self._subscriptions[0])) is not None:
            heard |= message.session == session
        return heard

    def _next(self, subscription: ArraySubscription) -> Any:
        """Return the next message of a subscription, or None.

        Any participant may publish, so bytes that cannot be decoded, and messages of this session
        that the simulator did not send, are skipped.
        """
        while True:
            try:
                message = subscription.take()
            except ValueError as error:
                self._warn(f'message ignored: {error}')
                continue
            if message is None or message.session != self._session or self._accepts(subscription):
                return message

    def _is_awaited(self, message: Any) -> bool:
        return bool(message.session == self._session and message.step == self._step + 1)

    def take(self) -> tuple[int, Step]:
        """Return the step reached and the return value of `VectorEnv.step`.

        :raises ValueError: naming topic, field, actual and expected value.
        """
        step, observation = self.take_observation()
        return step, (observation, *self.take_results()())

    def take_observation(self) -> tuple[int, F32]:
        """Return the step reached and its observation, once that has arrived.

        :raises ValueError: naming topic, field, actual and expected value.
        """
        spec, observed = self._spec, self._observation
        assert spec is not None and observed is not None
        return observed.step, observation_of('observation: data', observed.data, spec)

    def take_results(self) -> Callable[[], Results]:
        """Return a function that checks and returns the results of a complete answer."""
        assert self._reward is not None
        found = functools.partial(self._results, self._reward, self._episodes)
        self._observation = self._reward = self._episodes = None
        return found

    def _results(self, reward: Any, ended: Any) -> Results:
        """Return what an action led to.

        :param ended: the message of finished episodes, None if there was none.
        :raises ValueError: naming topic, field, actual and expected value.
        """
        spec = self._spec
        assert spec is not None
        _check_reward(spec, reward)
        finished = reward.final_rows.astype(np.int64)
        episodes: Episodes = NO_EPISODES
        if finished.size and ended is not None:
            _check_episodes(spec, ended, finished)
            episodes = conversion.episodes_from_message(ended)
        return reward.reward, reward.terminated.view(np.bool_), reward.truncated.view(np.bool_), {
            'final_rows': finished,
            'final_observation': reward.final_observation.reshape(
                len(finished), spec.observation_size),
            'episodes': episodes,
        }


def observation_of(where: str, values: NDArray[np.float32], spec: WorldSpec) -> F32:
    """Return received values as an observation of all rockets, `(N, D)`.

    :param where: topic or service, and field.
    :raises ValueError: naming `where`, actual and expected value.
    """
    _check_size(where, values, spec.num_envs * spec.observation_size)
    _check_finite(where, values)
    return values.reshape(spec.num_envs, spec.observation_size)


def _check_size(where: str, values: NDArray[Any], expected: int) -> None:
    if len(values) != expected:
        raise ValueError(f'{where}: {len(values)} values, expected {expected}')


def _check_finite(where: str, values: NDArray[Any]) -> None:
    if not np.isfinite(values).all():
        place = int(np.argmin(np.isfinite(values)))
        raise ValueError(f'{where}: value {place} is {values[place]}, expected finite numbers')


def _check_reward(spec: WorldSpec, reward: Any) -> None:
    """Check a reward message before anything is learned from it.

    :raises ValueError: naming topic, field, actual and expected value.
    """
    rows, count = reward.final_rows, spec.num_envs
    for name in ('reward', 'terminated', 'truncated'):
        _check_size(f'reward: {name}', getattr(reward, name), count)
    _check_size(
        'reward: final_observation', reward.final_observation, len(rows) * spec.observation_size)
    _check_finite('reward: reward', reward.reward)
    ended = reward.terminated | reward.truncated
    if ended.max() > 1:
        raise ValueError(
            f'reward: terminated or truncated: got {ended.max()}, expected 0 or 1')
    found = np.flatnonzero(ended)
    if len(rows) != len(found) or (len(rows) and (rows != found).any()):
        raise ValueError(
            f'reward: final_rows: got {_some(rows)}, expected {_some(found)}, '
            'the rockets whose episodes ended')
    _check_finite('reward: final_observation', reward.final_observation)


def _check_episodes(spec: WorldSpec, message: Any, rows: NDArray[Any]) -> None:
    """Check the episodes that ended at a step.

    :param rows: `(K,)` rockets that finished, according to `reward`.
    :raises ValueError: naming topic, field, actual and expected value.
    """
    for name in message._fields[2:]:
        values = getattr(message, name)
        _check_size(f'episodes: {name}', values, len(rows))
        _check_finite(f'episodes: {name}', values)
    if (message.row != rows).any():
        raise ValueError(
            f'episodes: row: got {_some(message.row)}, expected {_some(rows)}, as in reward')
    for name, limit in (('outcome', len(spec.outcomes)), ('episode', 2**63)):
        values = getattr(message, name)
        if values.max() >= limit:
            raise ValueError(f'episodes: {name}: got {values.max()}, expected less than {limit}')


def _some(values: NDArray[Any]) -> str:
    """Return the first few values as text."""
    return ' '.join(map(str, values[:8].tolist())) + (' ...' if len(values) > 8 else '') or 'none'
