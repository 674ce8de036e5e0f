# SPDX-License-Identifier: Apache-2.0
"""What learns: policy, critic and their optimisers, saved and put back as one."""
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor
from torch import nn
from torch.optim import Adam

from ppo_agent_node.learning import ppo
from ppo_agent_node.learning import sealed_file
from ppo_agent_node.learning import streams
from ppo_agent_node.learning.config import Config
from ppo_agent_node.learning.networks import Critic
from ppo_agent_node.learning.policies import make_policy
from ppo_agent_node.learning.ppo import Diagnostics
from ppo_agent_node.learning.rollout import Rollout
from ppo_agent_node.learning.sealed_file import Tensors
from rocket_sim_node.worlds import WorldSpec


class Learner:
    """Policy and critic for a world, and how they learn."""

    def __init__(self, spec: WorldSpec, config: Config) -> None:
        """Make both networks, which depend on the seed alone."""
        network, self._seed = config.network, config.run.seed
        self._ppo = config.ppo
        self.policy = make_policy(spec, network, streams.generator(self._seed, 'policy'))
        self.critic = Critic(
            spec.observation_size, network.hidden_sizes,
            streams.generator(self._seed, 'critic'), network.activation)
        for normaliser in (self.policy.normaliser, self.critic.normaliser):
            for name in set(network.fine_observations.split()) & set(spec.observation_names):
                normaliser.width[spec.observation_names.index(name)] = network.fine_width
        noise = self.policy.noise_parameters()
        apart = {id(parameter) for parameter in noise}
        groups = [{'params': [p for p in self.policy.parameters() if id(p) not in apart]}]
        self.policy_optimiser = Adam(
            groups + [{'params': noise}] if noise else groups, fused=True, eps=1e-5)
        self.critic_optimiser = Adam(self.critic.parameters(), fused=True, eps=1e-5)

    def learn(
        self, iteration: int, rollout: Rollout, poll: Callable[[], None],
    ) -> tuple[Diagnostics, float]:
        """Improve both networks by one roll-out; return how it went and the learning rate.

        :param iteration: from 1.
        :param poll: called before each minibatch; may raise, which leaves it half-done.
        """
        c = self._ppo
        done = (iteration - 1) / c.iterations
        part = 1 - done if c.learning_rate_decay else 1.0
        rates = (c.actor_learning_rate * part, c.log_std_learning_rate * part)
        for group, rate in zip(self.policy_optimiser.param_groups, rates, strict=False):
            group['lr'] = rate
        self.critic_optimiser.param_groups[0]['lr'] = c.critic_learning_rate * part
        batch = rollout.batch(self.critic, c.gamma, c.gae_lambda, c.reward_scale)
        diagnostics = ppo.update(
            self.policy, self.critic, self.policy_optimiser, self.critic_optimiser, batch, c,
            streams.generator(self._seed, 'minibatches', iteration),
            train_policy=iteration > c.critic_warmup_iterations, poll=poll)
        self.policy.constrain(iteration / c.iterations)
        return diagnostics, rates[0]

    def tensors(self) -> Tensors:
        """Return copies of all weights and of the optimisers' state."""
        found = {name: tensor.clone() for name, tensor in self._weights().items()}
        for name, optimiser in self._optimisers().items():
            for index, state in optimiser.state_dict()['state'].items():
                found |= {f'{name}.{index}.{k}': v.clone() for k, v in state.items()}
        return found

    def load(self, path: Path, tensors: Tensors) -> None:
        """Put back what `tensors` returned.

        :param path: of the file they come from, for messages.
        :raises ValueError: when they do not fit; nothing changes.
        """
        weights = self._weights()
        states = {}
        expected = dict(weights)
        for name, optimiser in self._optimisers().items():
            states[name] = {
                index: _state_like(parameter)
                for index, parameter in enumerate(
                    p for group in optimiser.param_groups for p in group['params'])
                if f'{name}.{index}.step' in tensors
            }
            for index, state in states[name].items():
                expected |= {f'{name}.{index}.{key}': like for key, like in state.items()}
        sealed_file.expect_tensors(path, tensors, expected)
        with torch.no_grad():
            for name, tensor in weights.items():
                tensor.copy_(tensors[name])
        for name, optimiser in self._optimisers().items():
            optimiser.load_state_dict({
                'param_groups': optimiser.state_dict()['param_groups'],
                'state': {
                    index: {key: tensors[f'{name}.{index}.{key}'].clone() for key in state}
                    for index, state in states[name].items()
                },
            })

    def _weights(self) -> dict[str, Tensor]:
        networks: dict[str, nn.Module] = {'policy': self.policy, 'critic': self.critic}
        return {
            f'{kind}.{name}': tensor
            for kind, network in networks.items()
            for name, tensor in network.state_dict().items()
        }

    def _optimisers(self) -> dict[str, Adam]:
        return {
            'policy_optimiser': self.policy_optimiser, 'critic_optimiser': self.critic_optimiser}


def _state_like(parameter: Tensor) -> dict[str, Tensor]:
    """Return tensors of the shapes that Adam keeps for a parameter."""
    return {
        'step': torch.zeros(()), 'exp_avg': torch.zeros_like(parameter),
        'exp_avg_sq': torch.zeros_like(parameter),
    }
