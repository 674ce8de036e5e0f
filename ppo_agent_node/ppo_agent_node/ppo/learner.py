# SPDX-License-Identifier: Apache-2.0
"""Learner: policy, critic and their optimisers, saved and restored together."""
from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import astuple
from functools import reduce
from operator import add
from pathlib import Path
from typing import Protocol
from typing import TypeVar

import torch
from torch import Tensor
from torch import nn

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.devices import find_device
from ppo_agent_node.distributed.ranks import ALONE
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.ppo import update
from ppo_agent_node.ppo.networks.adam import FlatAdam
from ppo_agent_node.ppo.networks.features import make_features
from ppo_agent_node.ppo.networks.features import used_observations
from ppo_agent_node.ppo.networks.mlp import Critic
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.ppo.policies.factory import symmetry_of
from ppo_agent_node.ppo.rollout_buffer import Batch
from ppo_agent_node.ppo.update import Diagnostics
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.tensor_file import Tensors
from rocket_sim_node.worlds import WorldSpec

_VALUED_AT_ONCE = 4096
"""Observations evaluated at once; many more would not stay in the cache between layers."""
_RATE_STEP = 1.5
"""Factor by which the actor's learning rate changes after an update, see `desired_kl`."""
_RATE_BOUNDS = (1e-3, 1e3)
_RATE_FACTOR = 'rate_factor'
M = TypeVar('M', bound=nn.Module)


class Samples(Protocol):
    """Interface of a completed roll-out."""

    def batch(
        self, critic: Callable[[Tensor], Tensor], gamma: float, gae_lambda: float,
        reward_scale: float,
    ) -> Batch:
        """Return the samples, flattened, with their advantages."""
        ...


class Learner:
    """Policy and critic of a world, with their optimisers.

    Both are on the CPU, where roll-outs are flown. With another device, updates work on copies
    there, and the results are copied back.
    """

    def __init__(self, spec: WorldSpec, config: Config, ranks: Ranks = ALONE) -> None:
        """Create both networks, initialised from the seed alone.

        :param ranks: learners of the same run, which average their gradients.
        :raises ValueError: when the configured device is not available, for features that cannot
            be computed from the world's observations, for fine or hidden observations that lack
            what a symmetry exchanges them with, or for hidden ones that the features contain.
        """
        network, self._seed, self._ranks = config.network, config.run.seed, ranks
        self._ppo, self.device = config.ppo, find_device(config.run.device)
        symmetry = symmetry_of(spec, network)

        def places(setting: str) -> list[int]:
            named = set(getattr(network, setting).replace(',', ' ').split())
            found = [i for i, name in enumerate(spec.observation_names) if name in named]
            if symmetry:
                symmetry.check_closed(setting, found, spec.observation_names)
            return found

        self.policy = make_policy(spec, network, random_streams.generator(self._seed, 'policy'))
        self.critic = Critic(
            spec.observation_size, network.hidden_sizes,
            random_streams.generator(self._seed, 'critic'), network.activation,
            make_features(network.features, spec.observation_names, spec.settings), symmetry)
        for normaliser in (self.policy.normaliser, self.critic.normaliser):
            for place in places('fine_observations'):
                normaliser.width[place] = network.fine_width
        used = used_observations(network.features)
        for place in places('hidden_observations'):
            if (name := spec.observation_names[place]) in used:
                raise ValueError(
                    f'hidden_observations: got {network.hidden_observations!r}, expected no '
                    f'{name} with features: {network.features!r}, which are computed from it')
            self.policy.normaliser.hide(place)
        self._rate_factor = torch.ones((), dtype=torch.float64)
        """Factor of the actor's learning rate, see `_adapt_rate`."""
        self._policy_update = update.PolicyUpdate(self._there(self.policy), self._ppo, ranks)
        self._critic_update = update.CriticUpdate(self._there(self.critic), self._ppo, ranks)

    def _there(self, network: M) -> M:
        here = torch.device('cpu')
        return network if self.device == here else copy.deepcopy(network).to(self.device)

    def learn(
        self, iteration: int, rollout: Samples, poll: Callable[[], None],
    ) -> tuple[Diagnostics, float]:
        """Update both networks with one roll-out; return diagnostics and the learning rate.

        :param iteration: from 1.
        :param poll: called before each minibatch; may raise, which leaves the update incomplete.
        :raises ValueError: when the new weights are not finite.
        :raises RankLost: when another rank is gone.
        """
        c = self._ppo
        self._carry(there=True)  # the critic evaluates the roll-out there
        return self.improve(
            iteration,
            rollout.batch(self._values, self.gamma(iteration), c.gae_lambda, c.reward_scale), poll)

    def gamma(self, iteration: int) -> float:
        """Return the discount of an iteration, from 1."""
        c = self._ppo
        if c.gamma_first < 0 or c.iterations < 2:
            return c.gamma
        part = (iteration - 1) / (c.iterations - 1)
        return float(1 - (1 - c.gamma_first) ** (1 - part) * (1 - c.gamma) ** part)

    def entropy_coefficient(self, iteration: int) -> float:
        """Return the entropy coefficient of an iteration, from 1."""
        c = self._ppo
        if c.entropy_coefficient_final < 0:
            return c.entropy_coefficient
        part = (iteration - 1) / c.iterations
        return (1 - part) * c.entropy_coefficient + part * c.entropy_coefficient_final

    def _values(self, observation: Tensor) -> Tensor:
        """Return the critic's values of observations `(S, D)` on the CPU, `(S,)`."""
        return torch.cat([
            self._critic_update.critic(part.to(self.device)).cpu()
            for part in observation.split(_VALUED_AT_ONCE)])

    def improve(
        self, iteration: int, batch: Batch, poll: Callable[[], None],
    ) -> tuple[Diagnostics, float]:
        """Update both networks with samples, as `learn` does with a roll-out."""
        c = self._ppo
        self._carry(there=True)
        part = 1 - (iteration - 1) / c.iterations if c.learning_rate_decay else 1.0
        rates = [c.actor_learning_rate * part * float(self._rate_factor)]
        if self.policy.noise_parameters():
            rates.append(c.log_std_learning_rate * part)
        diagnostics = update.update(
            self._policy_update, self._critic_update,
            self._evenly(batch, iteration, poll).to(self.device),
            random_streams.generator(self._seed, 'minibatches', iteration), rates,
            c.critic_learning_rate * part,
            train_policy=c.whole_episodes or iteration > c.critic_warmup_iterations,
            train_critic=not c.whole_episodes, poll=poll,
            entropy_coefficient=self.entropy_coefficient(iteration))
        of_all = self._ranks.main.gather(astuple(diagnostics), poll)
        diagnostics = Diagnostics(*(
            reduce(add, each) / len(each) for each in zip(*of_all, strict=True)))
        self._adapt_rate(diagnostics.approx_kl)
        self._carry(there=False)
        self.policy.constrain(iteration / c.iterations)
        self.copy_first(poll)
        for name, network in (('policy', self.policy), ('critic', self.critic)):
            if not all(bool(weight.isfinite().all()) for weight in network.parameters()):
                raise ValueError(
                    f'iteration {iteration}: the weights of the {name} are no longer finite: '
                    'rewards or learning rates are too large; a resumed run would end '
                    'the same way')
        return diagnostics, rates[0]

    def copy_first(self, poll: Callable[[], None]) -> None:
        """Take the state of rank 0: different processors may round differently."""
        if self._ranks.count == 1:
            return
        state = self.tensors()
        self._ranks.main.copy_first_(state.values(), poll)
        self._restore(state)

    def _evenly(self, batch: Batch, iteration: int, poll: Callable[[], None]) -> Batch:
        """Return as many of the samples as the rank with the fewest has.

        Roll-outs of whole episodes have as many samples as the episodes are long. Which of them
        are left out is drawn at random.
        """
        samples = len(batch.value)
        if not self._ppo.whole_episodes:
            return batch
        fewest = min(self._ranks.main.gather(samples, poll))
        if fewest == samples:
            return batch
        kept = torch.randperm(
            samples, generator=random_streams.generator(self._seed, 'even', iteration))[:fewest]
        return Batch(*(tensor[kept] for tensor in batch))

    def _adapt_rate(self, divergence: float) -> None:
        """Adapt the learning rate to the desired KL divergence, nats; NaN: no update happened.

        As `schedule='adaptive'` of rsl_rl does (Rudin et al., 'Learning to walk in minutes using
        massively parallel deep reinforcement learning', 2022). As the standard deviation shrinks,
        no fixed rate suits: the same step of the weights moves an action by more and more
        deviations.
        """
        desired, (least, most) = self._ppo.desired_kl, _RATE_BOUNDS
        if desired and divergence > 2 * desired:
            self._rate_factor.div_(_RATE_STEP).clamp_min_(least)
        elif desired and divergence < desired / 2:
            self._rate_factor.mul_(_RATE_STEP).clamp_max_(most)

    def _carry(self, there: bool) -> None:
        """Copy the networks to the device, or back, if it is not the CPU."""
        for here, away in (
            (self.policy, self._policy_update.policy), (self.critic, self._critic_update.critic),
        ):
            if here is not away:
                source, target = (here, away) if there else (away, here)
                target.load_state_dict(source.state_dict())

    def tensors(self) -> Tensors:
        """Return copies of all weights and of the optimisers' state, on the CPU."""
        return {name: tensor.to('cpu', copy=True) for name, tensor in self._state().items()}

    def load(self, path: Path, tensors: Tensors) -> None:
        """Restore the result of `tensors`, on any device.

        :param path: of the source file, for messages.
        :raises ValueError: when the tensors do not fit; nothing changes.
        """
        tensor_file.expect_tensors(path, tensors, self._state())
        self._restore(tensors)

    def _restore(self, tensors: Tensors) -> None:
        if self._ppo.desired_kl:
            self._rate_factor.copy_(tensors[_RATE_FACTOR])
        for kind, part in self._parts().items():
            mine = {name.removeprefix(f'{kind}.'): tensor for name, tensor in tensors.items()
                    if name.startswith(f'{kind}.')}
            part.load_state_dict(mine)

    def _parts(self) -> dict[str, nn.Module | FlatAdam]:
        return {
            'policy': self.policy, 'critic': self.critic,
            'policy_optimiser': self._policy_update.optimiser,
            'critic_optimiser': self._critic_update.optimiser}

    def _state(self) -> dict[str, Tensor]:
        adapted = {_RATE_FACTOR: self._rate_factor} if self._ppo.desired_kl else {}
        return adapted | {
            f'{kind}.{name}': tensor for kind, part in self._parts().items()
            for name, tensor in part.state_dict().items()}
