# SPDX-License-Identifier: Apache-2.0
"""PPO in one file, for reading and changing: Gymnasium, NumPy and PyTorch, nothing else.

python docs/examples/single_file_ppo.py --steps 1000000
python docs/examples/single_file_ppo.py --name hoverslam/Rocket-v1 --curriculum --num-envs 256 \
    --num-steps 128 --minibatches 8 --epochs 4 --learning-rate 1e-3 --gamma 0.998 \
    --entropy-weight 0

The update follows Schulman et al., Proximal Policy Optimization Algorithms (2017), with
generalised advantages (Schulman et al., 2016). Episodes that were cut short (truncated) are
bootstrapped from their last observation.
"""
from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor
from torch import nn
from torch.distributions import Categorical
from torch.distributions import Normal

import rocket_sim_node.gym


@dataclass(frozen=True)
class Options:
    """Settings; each is an argument of the command line."""

    name: str = rocket_sim_node.gym.IDS['lunar_lander']
    simulators: str = ''
    """Namespaces such as `/sim_*` to fly simulators over DDS; empty: in process."""
    curriculum: bool = False
    """begin episodes near the ground, and ever higher"""
    num_envs: int = 64
    num_steps: int = 64
    """steps of each environment in a roll-out"""
    steps: int = 1_000_000
    """steps of all environments together"""
    seed: int = 1
    learning_rate: float = 2e-3
    gamma: float = 0.999
    gae_lambda: float = 0.98
    epochs: int = 8
    minibatches: int = 16
    clip_range: float = 0.2
    entropy_weight: float = 0.003
    value_weight: float = 0.5
    max_grad_norm: float = 1.0
    output: str = 'single_file_ppo.pt'
    """file for the weights; an existing one is replaced"""


class Agent(nn.Module):
    """An actor for boxes or whole numbers, and a critic."""

    def __init__(self, envs: Any) -> None:
        """Create both networks for the spaces of a vector environment."""
        super().__init__()
        size = envs.single_observation_space.shape[0]
        space = envs.single_action_space
        self.discrete = isinstance(space, gymnasium.spaces.Discrete)
        actions = int(space.n) if self.discrete else space.shape[0]
        self.actor = mlp(size, actions, 0.01)
        self.critic = mlp(size, 1, 1.0)
        self.log_deviation = nn.Parameter(torch.zeros(actions))

    def distribution(self, observation: Tensor) -> Categorical | Normal:
        """Return the distribution of actions."""
        output = self.actor(observation)
        if self.discrete:
            return Categorical(logits=output)
        return Normal(output, self.log_deviation.exp().expand_as(output))

    def log_prob(self, policy: Categorical | Normal, action: Tensor) -> Tensor:
        """Return the log-probability of each action, `(N,)`."""
        found = policy.log_prob(action)
        return found if self.discrete else found.sum(-1)

    def entropy(self, policy: Categorical | Normal) -> Tensor:
        """Return the entropy of each distribution, `(N,)`."""
        return policy.entropy() if self.discrete else policy.entropy().sum(-1)

    def value(self, observation: Tensor) -> Tensor:
        """Return the expected return, `(N,)`, in units of 50."""
        return self.critic(observation).squeeze(-1)


def mlp(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Return a network with two hidden layers and orthogonal initial weights."""
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(),
              nn.Linear(64, outputs)]
    for layer, scale in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def collect(envs: Any, agent: Agent, observation: np.ndarray, o: Options) -> tuple[Any, ...]:
    """Fly one roll-out; return its batch, the next observation and the returns of episodes."""
    shape = o.num_steps, o.num_envs
    kept: dict[str, list[Tensor]] = {'observation': [], 'action': [], 'log_prob': [], 'value': []}
    reward, done = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    returns: list[float] = []
    for step in range(o.num_steps):
        seen = torch.as_tensor(observation)
        with torch.no_grad():
            policy = agent.distribution(seen)
            action = policy.sample()
            found = seen, action, agent.log_prob(policy, action), agent.value(seen)
        for values, tensor in zip(kept.values(), found, strict=True):
            values.append(tensor)
        observation, raw, terminated, truncated, info = envs.step(action.numpy())
        reward[step] = raw / 50
        done[step] = terminated | truncated
        if 'final_info' in info:
            returns += info['final_info']['episode_return'][info['_final_info']].tolist()
        for row in np.flatnonzero(truncated):
            with torch.no_grad():
                last = agent.value(torch.as_tensor(info['final_obs'][row][None]))
            reward[step, row] += o.gamma * last.item()
    batch = {name: torch.stack(values) for name, values in kept.items()}
    with torch.no_grad():
        following = agent.value(torch.as_tensor(observation)).numpy()
    value, advantage = batch['value'].numpy(), np.zeros(shape, np.float32)
    sum_of_errors = np.zeros(o.num_envs, np.float32)
    for step in reversed(range(o.num_steps)):
        goes_on = 1 - done[step]
        error = reward[step] + o.gamma * following * goes_on - value[step]
        sum_of_errors = error + o.gamma * o.gae_lambda * goes_on * sum_of_errors
        advantage[step], following = sum_of_errors, value[step]
    batch['advantage'] = torch.as_tensor(advantage)
    batch['return'] = batch['advantage'] + batch['value']
    return {name: values.flatten(0, 1) for name, values in batch.items()}, observation, returns


def update(agent: Agent, optimiser: torch.optim.Optimizer, batch: dict[str, Tensor],
           o: Options) -> None:
    """Improve the agent with the clipped objective (equation 9 of the paper)."""
    for _ in range(o.epochs):
        for rows in torch.randperm(len(batch['action'])).tensor_split(o.minibatches):
            part = {name: values[rows] for name, values in batch.items()}
            policy = agent.distribution(part['observation'])
            ratio = (agent.log_prob(policy, part['action']) - part['log_prob']).exp()
            advantage = part['advantage']
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            clipped = ratio.clamp(1 - o.clip_range, 1 + o.clip_range)
            policy_loss = -torch.minimum(ratio * advantage, clipped * advantage).mean()
            value_loss = (agent.value(part['observation']) - part['return']).square().mean()
            entropy = agent.entropy(policy).mean()
            loss = policy_loss + o.value_weight * value_loss - o.entropy_weight * entropy
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), o.max_grad_norm)
            optimiser.step()


def train(o: Options) -> Agent:
    """Train an agent and return it."""
    torch.manual_seed(o.seed)
    torch.set_num_threads(1)
    envs = gymnasium.make_vec(
        o.name, num_envs=o.num_envs, seed=o.seed, simulators=o.simulators)
    if o.curriculum:
        envs = rocket_sim_node.gym.ReverseCurriculum(envs)
    agent = Agent(envs)
    optimiser = torch.optim.Adam(agent.parameters(), o.learning_rate, eps=1e-5)
    observation, _ = envs.reset()
    began, each = time.monotonic(), o.num_envs * o.num_steps
    iterations = max(o.steps // each, 1)
    for iteration in range(iterations):
        optimiser.param_groups[0]['lr'] = o.learning_rate * (1 - iteration / iterations)
        batch, observation, returns = collect(envs, agent, observation, o)
        update(agent, optimiser, batch, o)
        steps = (iteration + 1) * each
        mean = f'{np.mean(returns):.1f}' if returns else 'none yet'
        print(f'{steps} steps, return {mean}, {steps / (time.monotonic() - began):.0f} steps/s')
    envs.close()
    return agent


def main() -> None:
    """Train and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    for field in fields(Options):
        name = f'--{field.name.replace("_", "-")}'
        if field.type == 'bool':
            parser.add_argument(name, action='store_true')
        else:
            parser.add_argument(name, type=type(field.default), default=field.default)
    options = Options(**vars(parser.parse_args()))
    torch.save(train(options).state_dict(), options.output)
    print(f'policy: {options.output}')


if __name__ == '__main__':
    main()
