# SPDX-License-Identifier: Apache-2.0
"""A compact PPO in one process on EnvPool's LunarLander-v3, as a peer in `bench result`.

It is optimised for speed: two small networks in one graph, one fused Adam, buffers that are
allocated once, and no code except for learning. Its settings were tuned for the time to a mean
return of 200.
"""
from __future__ import annotations

import argparse
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import envpool
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch import nn

from benchmarks.time_to_result.result_lines import EVALUATION_SEED
from benchmarks.time_to_result.result_lines import VERIFICATION_SEED
from benchmarks.time_to_result.result_lines import StatusPublisher

NAME = 'LunarLander-v3'
EVALUATED = 100
"""number of episodes in an evaluation"""
_WINDOW = 64
"""number of episodes in a landing rate"""
_LANDED = 100.0
"""last reward of an episode that landed"""
THREADS, ENV_THREADS = 1, 2
"""threads of torch and of EnvPool; these were the fastest on two cores"""


@dataclass(frozen=True)
class Settings:
    """Settings of learning; everything else is as in Schulman et al., 2017."""

    num_envs: int = 64
    n_steps: int = 64
    batch_size: int = 512
    n_epochs: int = 8
    learning_rate: float = 3e-3
    decay_steps: int = 614_400
    """steps after which the linearly falling learning rate would be 0; it stays at 5 % or more"""
    gamma: float = 0.999
    gae_lambda: float = 0.98
    clip_range: float = 0.2
    entropy_coefficient: float = 0.003
    max_grad_norm: float = 1.0
    reward_scale: float = 0.02
    hidden: int = 64
    evaluation_interval: int = 2
    """iterations between two evaluations"""
    evaluation_from: float = 0.45
    """landing rate of the last 64 episodes above which the policy is evaluated"""


def make_pool(num_envs: int, seed: int, threads: int) -> Any:
    """Return a batch of landers with episodes of at most 1 000 steps."""
    return envpool.make(
        NAME, env_type='gymnasium', num_envs=num_envs, batch_size=num_envs,
        num_threads=threads, seed=seed)


def network(hidden: int, outputs: int, last_gain: float) -> nn.Sequential:
    """Return a network 8 -> hidden -> hidden -> outputs with tanh and orthogonal weights."""
    layers: list[nn.Module] = []
    for inputs, units, gain in (
            (8, hidden, 2**0.5), (hidden, hidden, 2**0.5), (hidden, outputs, last_gain)):
        linear = nn.Linear(inputs, units)
        nn.init.orthogonal_(linear.weight, gain)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class Agent:
    """Actor, critic, their optimiser, and the buffers of the roll-out."""

    def __init__(self, settings: Settings, seed: int, env_threads: int) -> None:
        """Make the networks and begin the first episodes."""
        torch.manual_seed(seed)
        self.s = s = settings
        self.actor, self.critic = network(s.hidden, 4, 0.01), network(s.hidden, 1, 1.0)
        self.parameters = [*self.actor.parameters(), *self.critic.parameters()]
        self.optimiser = torch.optim.Adam(
            self.parameters, lr=s.learning_rate, eps=1e-5, fused=True)
        self._pool = make_pool(s.num_envs, seed, env_threads)
        shape = (s.n_steps, s.num_envs)
        self._observation = torch.zeros(s.n_steps + 1, s.num_envs, 8)
        self._action = torch.zeros(shape, dtype=torch.int64)
        self._log_prob, self._reward = torch.zeros(shape), torch.zeros(shape)
        self._terminated = torch.zeros(shape, dtype=torch.bool)
        self._done = torch.zeros(s.n_steps + 1, s.num_envs, dtype=torch.bool)
        self._observation.numpy()[-1] = self._pool.reset()[0]
        self._landed: deque[bool] = deque(maxlen=_WINDOW)

    @torch.inference_mode()
    def fly(self) -> None:
        """Fill the buffers. The step after the end of an episode is a reset, not a sample."""
        self._observation[0], self._done[0] = self._observation[-1], self._done[-1]
        noise = -(-torch.rand(*self._action.shape, 4).log()).log()
        for step in range(self.s.n_steps):
            log_p = self.actor(self._observation[step]).log_softmax(-1)
            action = (log_p + noise[step]).argmax(-1)
            self._action[step] = action
            self._log_prob[step] = log_p.gather(-1, action[:, None])[:, 0]
            observation, reward, terminated, truncated, _ = self._pool.step(
                action.numpy().astype(np.int32))
            self._observation.numpy()[step + 1] = observation
            self._reward.numpy()[step] = reward
            self._terminated.numpy()[step] = terminated
            self._done.numpy()[step + 1] = terminated | truncated
            self._landed.extend((reward[terminated | truncated] == _LANDED).tolist())

    @property
    def landing_rate(self) -> float:
        """Landing rate of the most recent episodes, with exploration noise."""
        return sum(self._landed) / _WINDOW

    @torch.inference_mode()
    def samples(self) -> tuple[Tensor, ...]:
        """Return observations, actions, log-probabilities, advantages and targets, flat.

        After a truncation, the return continues with the value of the last observation, which
        EnvPool returns before it resets.
        """
        s = self.s
        value = self.critic(self._observation)[..., 0]
        following = value[1:].masked_fill(self._terminated, 0.0)
        delta = (self._reward * s.reward_scale + s.gamma * following - value[:-1]).numpy()
        going_on = s.gamma * s.gae_lambda * (~self._done[1:]).float().numpy()
        advantage = np.zeros_like(delta)
        last = np.zeros(s.num_envs, np.float32)
        for step in range(s.n_steps - 1, -1, -1):
            last = delta[step] + going_on[step] * last
            advantage[step] = last
        gained = torch.from_numpy(advantage)
        flown = ~self._done[:-1].flatten()
        return tuple(tensor.flatten(0, 1)[flown] for tensor in (
            self._observation[:-1], self._action, self._log_prob, gained, gained + value[:-1]))

    def learn(self, iteration: int) -> None:
        """Update both networks with the roll-out.

        :param iteration: number of the iteration, from 0.
        """
        s = self.s
        flown = iteration * s.n_steps * s.num_envs
        self.optimiser.param_groups[0]['lr'] = s.learning_rate * max(
            0.05, 1 - flown / s.decay_steps)
        # Copies, because autograd cannot use tensors that were made in inference mode.
        samples = tuple(tensor.clone() for tensor in self.samples())
        for _ in range(s.n_epochs):
            for index in torch.randperm(len(samples[0])).split(s.batch_size):
                observation, action, old, advantage, target = (t[index] for t in samples)
                log_p = self.actor(observation).log_softmax(-1)
                ratio = (log_p.gather(-1, action[:, None])[:, 0] - old).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - s.clip_range, 1 + s.clip_range)
                gain = torch.minimum(ratio * advantage, clipped * advantage).mean()
                entropy = -(log_p.exp() * log_p).sum(-1).mean()
                error = (self.critic(observation)[:, 0] - target).square().mean()
                loss = 0.5 * error - gain - s.entropy_coefficient * entropy
                self.optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.parameters, s.max_grad_norm)
                self.optimiser.step()

    @torch.inference_mode()
    def pilot(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the most likely actions `(N,)` for observations `(N, 8)`."""
        action: NDArray[np.int64] = self.actor(torch.from_numpy(observation)).argmax(-1).numpy()
        return action


def evaluate(agent: Agent, threads: int) -> float:
    """Return the mean return of 100 deterministic episodes, from the same starts each time."""
    pool = make_pool(EVALUATED, EVALUATION_SEED, threads)
    observation, _ = pool.reset()
    score, flying = np.zeros(EVALUATED), np.ones(EVALUATED, np.bool_)
    while flying.any():
        observation, reward, terminated, truncated, _ = pool.step(
            agent.pilot(observation).astype(np.int32))
        score += reward * flying
        flying &= ~(terminated | truncated)
    return float(score.mean())


def main() -> None:
    """Learn until an evaluation passes, then fly in Gymnasium's lander."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--seed', type=int, default=1, help='seed')
    parser.add_argument('--target', type=float, default=200.0, help='mean return at which to stop')
    parser.add_argument('--threads', type=int, default=THREADS, help='threads of torch')
    parser.add_argument('--env-threads', type=int, default=ENV_THREADS, help='threads of EnvPool')
    parser.add_argument(
        '--verify', type=int, default=500, help='episodes in Gymnasium after the training')
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    settings = Settings()
    teller = StatusPublisher(time.monotonic())
    agent = Agent(settings, options.seed, options.env_threads)
    iteration, mean = 0, float('-inf')
    while mean < options.target:
        agent.fly()
        agent.learn(iteration)
        iteration += 1
        if iteration % settings.evaluation_interval == 0 and (
                agent.landing_rate >= settings.evaluation_from):
            mean = evaluate(agent, options.env_threads)
            teller.evaluated(iteration * settings.n_steps * settings.num_envs, mean)
    if options.verify:
        # Imported late: importing Gymnasium takes time, and the training does not need it.
        from benchmarks.evaluation import gymnasium_lander

        flown = gymnasium_lander.fly(agent.pilot, options.verify, VERIFICATION_SEED)
        teller.verified(flown.episode_return)


if __name__ == '__main__':
    main()
