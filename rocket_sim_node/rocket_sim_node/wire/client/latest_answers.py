# SPDX-License-Identifier: Apache-2.0
"""Answers of a simulator in real time: the newest complete step, with the steps it skips.

Otherwise a pilot that takes longer than a step would act on observations that waited in a queue,
always a few steps late.
"""
from __future__ import annotations

import functools
from collections.abc import Callable
from collections.abc import Sequence
from typing import Any

import numpy as np

from rocket_sim_node.wire.client.answers import Answers
from rocket_sim_node.wire.client.answers import observation_of
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.jobs import Results

_KEPT = 16
"""Messages kept of each topic, regardless of the sender."""


class LatestAnswers(Answers):
    """Collects everything after a step, and answers with the newest complete step.

    Rewards of skipped steps are summed, and rockets that finished in them are reported as
    finished. A rocket that finished twice counts once in `final_rows`, with its last observation,
    and twice in `episodes`. Lost messages are missing, and so are those that no queue holds any
    more: a pilot more than four steps late receives the last four.
    """

    def __init__(
        self, subscriptions: Sequence[ArraySubscription], warn: Callable[[str], None],
        accepts: Callable[[ArraySubscription], bool] = lambda subscription: True,
    ) -> None:
        """Set up without awaiting a step; see :class:`Answers`."""
        super().__init__(subscriptions, warn, accepts)
        self._kept: tuple[dict[int, Any], ...] = ({}, {}, {})
        self._newest = 0
        """Newest complete step; 0 before there is one."""
        self._observed = False
        """Whether the observation of that step was taken, so that its results are next."""

    def await_step(self, session: int, step: int, early: bool = False) -> None:
        """Start to wait for the answer to this session and step, or to any later step."""
        if session != self._session:
            self._kept = ({}, {}, {})
        self._session, self._step, self._newest = session, step, 0
        self._observed = False
        for kept in self._kept:
            for past in [number for number in kept if number <= step]:
                del kept[past]

    @property
    def missing(self) -> ArraySubscription | None:
        """The subscription of the next missing part; None when a step is complete."""
        if self._newest:
            return None
        observations, rewards, _ = self._kept
        last = max(observations, default=0)
        place = (
            0 if not last or last < max(rewards, default=0) else
            1 if last not in rewards else 2)
        return self._subscriptions[place]

    def collect(self) -> bool:
        """Read the messages that have arrived; return whether a step is complete."""
        if self._observed:
            return True
        for subscription, kept in zip(self._subscriptions, self._kept, strict=True):
            while (message := self._next(subscription)) is not None:
                if message.session == self._session and message.step > self._step:
                    kept[message.step] = message
                    if len(kept) > _KEPT:
                        del kept[next(iter(kept))]
        observations, rewards, episodes = self._kept
        self._newest = max((
            step for step in observations if step in rewards
            and (step in episodes or not len(rewards[step].final_rows))), default=0)
        return self._newest > 0

    def observe(self) -> bool:
        """Read what has arrived; return whether a step is complete.

        Only then is it known which step is the newest.
        """
        return self.collect()

    def take_observation(self) -> tuple[int, F32]:
        """Return the newest complete step and its observation.

        :raises ValueError: naming topic, field, actual and expected value.
        """
        spec, newest = self._spec, self._newest
        assert spec is not None and newest
        self._observed = True
        return newest, observation_of(
            'observation: data', self._kept[0][newest].data, spec)

    def take_results(self) -> Callable[[], Results]:
        """Return a function that checks and returns the results of that and all skipped steps."""
        _, rewards, episodes = self._kept
        return functools.partial(self._sum, [
            (rewards[step], episodes.get(step))
            for step in sorted(rewards) if step <= self._newest])

    def _sum(self, messages: Sequence[tuple[Any, Any]]) -> Results:
        """Return the results of several steps as those of one.

        :raises ValueError: naming topic, field, actual and expected value.
        """
        found = [self._results(*pair) for pair in messages]
        if len(found) == 1:
            return found[0]
        reward, terminated, truncated, infos = zip(*found, strict=True)
        # Newest first, because the first of equal rows is used.
        rows, last = np.unique(
            np.concatenate([info['final_rows'] for info in infos[::-1]]), return_index=True)
        final = np.concatenate([info['final_observation'] for info in infos[::-1]])[last]
        return (
            np.sum(reward, axis=0, dtype=np.float32),
            np.logical_or.reduce(terminated), np.logical_or.reduce(truncated),
            {'final_rows': rows, 'final_observation': final,
             'episodes': Episodes.concatenate([info['episodes'] for info in infos])})
