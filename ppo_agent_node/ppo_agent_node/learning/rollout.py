# SPDX-License-Identifier: Apache-2.0
"""The roll-out buffer: what N rockets did in T steps, in memory that is allocated once."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any
from typing import NamedTuple

import torch
from torch import Tensor

from ppo_agent_node.learning.gae import advantages_and_returns
from ppo_agent_node.learning.policies import Policy
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import VectorEnv
from rocket_sim_node.worlds.base import F32


class Batch(NamedTuple):
    """Samples to learn from; S = T x N of them, or a minibatch."""

    observation: Tensor
    """`(S, D)`"""
    action: Tensor
    """`(S, *action_shape)`"""
    log_prob: Tensor
    """`(S,)`, when the action was taken"""
    advantage: Tensor
    """`(S,)`"""
    target: Tensor
    """`(S,)`, what the critic should have said"""
    value: Tensor
    """`(S,)`, what it did say"""

    def to(self, device: torch.device) -> Batch:
        """Return the samples on a device."""
        return Batch(*(tensor.to(device) for tensor in self))


class Rollout:
    """Buffers `(T, N, ...)` and the flight that fills them."""

    def __init__(self, steps: int, rockets: int, observation_size: int, policy: Policy) -> None:
        """Allocate for T steps of N rockets."""
        shape = (steps, rockets)
        self.observation = torch.zeros(*shape, observation_size)
        self.action = torch.zeros(*shape, *policy.action_shape, dtype=policy.action_dtype)
        self.log_prob = torch.zeros(shape)
        self.reward = torch.zeros(shape)
        self.terminated = torch.zeros(shape, dtype=torch.bool)
        self.truncated = torch.zeros(shape, dtype=torch.bool)
        self._finals: list[tuple[int, Tensor, Tensor]] = []
        self._last = torch.zeros(rockets, observation_size)

    @torch.no_grad()
    def collect(
        self,
        env: VectorEnv,
        observation: F32,
        policy: Policy,
        generator: torch.Generator,
        poll: Callable[[], None],
    ) -> tuple[F32, Episodes]:
        """Fly T steps from an observation `(N, D)`, overwriting what was here.

        :param poll: called before each step; may raise to end the flight.
        :return: the observation after the last step, and the episodes that finished.
        :raises EnvironmentRestarted: what was flown is lost.
        """
        finished: list[Episodes] = []
        self._finals.clear()
        for step in range(len(self.reward)):
            poll()
            self.observation.numpy()[step] = observation
            action, log_prob = policy.sample(self.observation[step], generator)
            self.action[step], self.log_prob[step] = action, log_prob
            observation, reward, terminated, truncated, info = env.step(action.numpy())
            self.reward.numpy()[step] = reward
            self.terminated.numpy()[step] = terminated
            self.truncated.numpy()[step] = truncated
            if len(info['episodes']):
                finished.append(info['episodes'])
            if truncated.any():
                self._keep_finals(step, info)
        self._last.numpy()[:] = observation
        return observation, Episodes.concatenate(finished)

    def _keep_finals(self, step: int, info: dict[str, Any]) -> None:
        rows = torch.tensor(info['final_rows'], dtype=torch.int64)
        cut = self.truncated[step, rows]
        self._finals.append((step, rows[cut], torch.tensor(info['final_observation'])[cut]))

    @torch.no_grad()
    def batch(
        self, critic: Callable[[Tensor], Tensor], gamma: float, gae_lambda: float,
        reward_scale: float,
    ) -> Batch:
        """Return all samples, flat, with the critic's values and the advantages they give.

        The value that follows a truncated step is that of the observation its episode ended
        with; the one that follows the last step, that of the observation after it.
        """
        steps, rockets = self.reward.shape
        value = critic(self.observation.flatten(0, 1)).view(steps, rockets)
        next_value = torch.cat((value[1:], critic(self._last)[None]))
        for step, rows, observation in self._finals:
            next_value[step, rows] = critic(observation)
        advantage, target = advantages_and_returns(
            self.reward * reward_scale, value, next_value, self.terminated, self.truncated,
            gamma, gae_lambda)
        return Batch(*(tensor.flatten(0, 1) for tensor in (
            self.observation, self.action, self.log_prob, advantage, target, value)))
