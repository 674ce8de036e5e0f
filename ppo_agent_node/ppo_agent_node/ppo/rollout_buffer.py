# SPDX-License-Identifier: Apache-2.0
"""Roll-out buffer: experience of rockets over T steps, in preallocated memory."""
from __future__ import annotations

import functools
import itertools
import math
import operator
import os
from collections.abc import Callable
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ppo_agent_node.ppo.gae import advantages_and_returns
from ppo_agent_node.ppo.policies.factory import Policy
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Results
from rocket_sim_node.worlds.jobs import Snapshot

Ended = tuple[int, Episodes]
"""A step of a roll-out, from 0, and the episodes that ended with it."""


def physical_memory() -> int:
    """Return the memory of this machine, bytes."""
    return os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES')


def in_order(groups: Sequence[Sequence[Ended]]) -> Episodes:
    """Return the episodes of all groups in the order in which they ended.

    Those of the same step are ordered by group.
    """
    ends = sorted(itertools.chain(*groups), key=operator.itemgetter(0))
    return Episodes.concatenate([episodes for _, episodes in ends])


class Batch(NamedTuple):
    """Samples to learn from; S = T x N of them, or a minibatch."""

    observation: Tensor
    """`(S, D)`."""
    action: Tensor
    """`(S, *action_shape)`."""
    log_prob: Tensor
    """`(S,)`, when the action was taken."""
    advantage: Tensor
    """`(S,)`."""
    target: Tensor
    """`(S,)`, the critic's targets."""
    value: Tensor
    """`(S,)`, the critic's outputs."""

    def to(self, device: torch.device) -> Batch:
        """Return the samples on a device."""
        return Batch(*(tensor.to(device) for tensor in self))


class Rollout:
    """Buffers `(T, G x N, ...)` and the jobs that fill them, one for each group of N rockets.

    A roll-out is a transaction: it begins in a snapshot and is complete when the next one has been
    taken. As its random numbers are derived (see random_streams), a repeated attempt is identical,
    bit for bit.
    """

    def __init__(
        self, steps: int, rockets: int, observation_size: int, policy: Policy, groups: int = 1,
    ) -> None:
        """Allocate for T steps of N rockets in each of G groups.

        :raises ValueError: when buffers and update need more than this machine's memory.
        """
        shape = (steps, groups * rockets)
        action_size = math.prod(policy.action_shape) * policy.action_dtype.itemsize
        # Memory per sample includes the update: each network has normalised observations, and
        # these and its other inputs again in the order of an epoch.
        entry = 5 * 4 * observation_size + 2 * action_size + 13 * 4 + 2
        needed, memory = steps * shape[1] * entry, physical_memory()
        if needed > memory:
            raise ValueError(
                f'n_steps: got {steps}, which with {groups} groups (num_groups) of {rockets} '
                f'rockets (num_envs) takes {needed / 2**30:,.0f} GiB to fly and learn from, '
                f"expected less than this machine's memory, {memory / 2**30:,.0f} GiB")
        self._rockets = rockets
        self.observation = torch.zeros(*shape, observation_size)
        self.action = torch.zeros(*shape, *policy.action_shape, dtype=policy.action_dtype)
        self.log_prob = torch.zeros(shape)
        self.reward = torch.zeros(shape)
        self.terminated = torch.zeros(shape, dtype=torch.bool)
        self.truncated = torch.zeros(shape, dtype=torch.bool)
        self._finals: list[list[tuple[int, Tensor, Tensor]]] = [[] for _ in range(groups)]
        self._last = torch.zeros(shape[1], observation_size)

    @property
    def steps(self) -> int:
        """Rocket steps of a roll-out, of all groups."""
        return self.reward.numel()

    def flight(
        self, group: int, begin: Reset | Restore, policy: Policy, generator: torch.Generator,
    ) -> Job[tuple[list[Ended], bytes]]:
        """Fly T steps from step 0, overwriting the group's last roll-out.

        :param begin: sets the world's initial state, usually a snapshot.
        :return: the episodes that finished, step by step, and the snapshot after the last step.
        """
        first = group * self._rockets
        columns = slice(first, first + self._rockets)
        seen = self.observation[:, columns].unbind()
        observations, actions, rewards, terminations, truncations = (
            buffer.numpy()[:, columns] for buffer in (
                self.observation, self.action, self.reward, self.terminated, self.truncated))
        finished: list[Ended] = []
        finals = self._finals[group]
        finals.clear()
        sample = policy.sampler(self.log_prob[:, columns], generator)

        def record(step: int, results: Results) -> None:
            rewards[step], terminations[step], truncated, info = results
            truncations[step] = truncated
            rows = info['final_rows']
            if len(rows):
                finished.append((step, info['episodes']))
                cut = truncated[rows]
                if cut.any():
                    finals.append((
                        step, first + torch.tensor(rows[cut], dtype=torch.int64),
                        torch.tensor(info['final_observation'][cut])))

        observation = yield begin
        for step in range(len(self.reward)):
            observations[step] = observation
            actions[step] = action = sample(step, seen[step]).numpy()
            observation = yield Act(action, functools.partial(record, step))
        self._last.numpy()[columns] = observation
        return finished, (yield Snapshot())

    @torch.no_grad()
    def batch(
        self, critic: Callable[[Tensor], Tensor], gamma: float, gae_lambda: float,
        reward_scale: float,
    ) -> Batch:
        """Return all samples, flattened, with the critic's values and the resulting advantages.

        The next value of a truncated step is that of its episode's final observation; of the last
        step, that of the following observation.
        """
        steps, rockets = self.reward.shape
        value = critic(self.observation.flatten(0, 1)).view(steps, rockets)
        next_value = torch.cat((value[1:], critic(self._last)[None]))
        for step, rows, observation in itertools.chain(*self._finals):
            next_value[step, rows] = critic(observation)
        advantage, target = advantages_and_returns(
            self.reward * reward_scale, value, next_value, self.terminated, self.truncated,
            gamma, gae_lambda)
        return Batch(*(tensor.flatten(0, 1) for tensor in (
            self.observation, self.action, self.log_prob, advantage, target, value)))
