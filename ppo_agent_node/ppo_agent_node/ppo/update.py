# SPDX-License-Identifier: Apache-2.0
"""PPO update of policy and critic from one roll-out.

Schulman et al., 'Proximal policy optimization algorithms', 2017, equation 7 (the clipped
objective), with the usual details of Huang et al., 'The 37 implementation details of proximal
policy optimization', 2022.

Policy and critic share only the samples and their order, so each learns in its own loop, and on a
CPU in its own thread. Where no critic learns, two threads share the policy's minibatches.
Gradients are in closed form: of the losses in `losses`, of the distributions in the policies, of
the networks in `backpropagation`.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ppo_agent_node.config.training_config import PPOConfig
from ppo_agent_node.distributed.ranks import ALONE
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.ppo.losses import clipped_objective
from ppo_agent_node.ppo.losses import error_gradient
from ppo_agent_node.ppo.losses import objective_gradient
from ppo_agent_node.ppo.losses import squared_error
from ppo_agent_node.ppo.minibatches import Minibatches
from ppo_agent_node.ppo.networks.adam import FlatAdam
from ppo_agent_node.ppo.networks.adam import GradientOf
from ppo_agent_node.ppo.networks.backpropagation import Backpropagation
from ppo_agent_node.ppo.networks.mlp import Critic
from ppo_agent_node.ppo.parallel import Begin
from ppo_agent_node.ppo.parallel import Poll
from ppo_agent_node.ppo.parallel import both
from ppo_agent_node.ppo.parallel import in_halves
from ppo_agent_node.ppo.parallel import second_thread
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.rollout_buffer import Batch

NAN = float('nan')


@dataclass(frozen=True)
class Diagnostics:
    """Diagnostics of an update, by CleanRL's names; NaN for a part that did not happen."""

    policy_loss: float
    """Negative clipped objective, mean over the samples used."""
    value_loss: float
    """Half the mean squared error of the critic, in units of (reward x reward_scale)^2."""
    entropy: float
    """Entropy of the policy, mean over the samples, nats."""
    approx_kl: float
    """KL divergence of the policy's change, nats: mean of r - 1 - log r over the last minibatch
    (Schulman, 'Approximating KL divergence', 2020, estimator k3)."""
    clipfrac: float
    """Fraction of samples whose ratio left the clip range."""
    explained_variance: float
    """1 - Var(target - value) / Var(target), before the update: 1 for a perfect critic, 0 for one
    no better than a constant."""
    grad_norm: float
    """Gradient norm of the policy before clipping, mean over the minibatches."""
    updates: float
    """Number of minibatches that the policy learned from."""


def explained_variance(value: Tensor, target: Tensor) -> float:
    """Return 1 - Var(target - value) / Var(target); NaN when the targets are all equal."""
    variance = target.var()
    return float(1 - (target - value).var() / variance) if variance > 0 else NAN


class CriticUpdate:
    """Updates the critic; holds its optimiser."""

    def __init__(self, critic: Critic, config: PPOConfig, ranks: Ranks = ALONE) -> None:
        """Take over the critic's parameters."""
        self.critic, self.config = critic, config
        self._channel, self._batch_size = ranks.critic, ranks.share(config.batch_size)
        self.optimiser = FlatAdam(
            [list(critic.value.parameters())], ties=critic.value.ties())
        self._network = Backpropagation(
            critic.value, self.optimiser.gradient_of, self._batch_size)

    @torch.inference_mode()
    def run(
        self, batch: Batch, orders: Sequence[Tensor], rate: float, poll: Poll,
    ) -> float:
        """Learn from each order of the samples; return the mean loss, half the squared error."""
        config = self.config
        seen = self.critic.normaliser.of_many(batch.observation)
        values = torch.empty_like(batch.value)
        minibatches = Minibatches(
            (seen, batch.target, batch.value), (values,), self._batch_size, self._network.rows)
        losses = []
        for order in orders:
            _, target, old = minibatches.shuffle(order)
            for start, stop, pieces in minibatches:
                poll()
                self.optimiser.gradient.zero_()
                for x, wanted, before, value in pieces:
                    self._network.forward(x, value[None])
                    error = error_gradient(value, before, wanted, config.value_clip_range)
                    self._network.backward(error[None])
                self._channel.sum_(self.optimiser.gradient, poll)
                self.optimiser.step(
                    [rate], config.max_grad_norm, (stop - start) * self._channel.count)
            losses.append(squared_error(values, old, target, config.value_clip_range).mean())
        return 0.5 * _sum(losses) / len(losses)


@dataclass(frozen=True)
class PolicyDiagnostics:
    """Diagnostics of the policy's part of an update; see Diagnostics."""

    policy_loss: float = NAN
    entropy: float = NAN
    approx_kl: float = NAN
    clipfrac: float = NAN
    grad_norm: float = NAN
    updates: float = 0


class PolicyGradient:
    """Computes the gradient of the policy's loss."""

    def __init__(
        self, policy: Policy, config: PPOConfig, gradient_of: GradientOf, most: int,
    ) -> None:
        """Prepare for pieces of at most `most` samples.

        :param gradient_of: returns the tensor to which a parameter's gradient is added.
        """
        self._policy, self._clip_range = policy, config.clip_range
        self._noise = [gradient_of(parameter) for parameter in policy.noise_parameters()]
        self._network = Backpropagation(
            policy.network, gradient_of, most, config.trained_layers)
        self.rows = self._network.rows

    @torch.inference_mode()
    def add(self, pieces: Sequence[tuple[Tensor, ...]], entropy_coefficient: float) -> None:
        """Add the gradients of pieces; fill in their results."""
        for x, action, old, advantage, log_ratio, entropy in pieces:
            found = self._policy.likelihood(self._network.forward(x), action)
            torch.sub(found.log_prob, old, out=log_ratio)
            entropy.copy_(found.entropy)
            by_log_prob = objective_gradient(log_ratio.exp(), advantage, self._clip_range).neg_()
            error, by_noise = self._policy.likelihood_gradient(
                found, action, by_log_prob, -entropy_coefficient)
            self._network.backward(error)
            for total, gradient in zip(self._noise, by_noise, strict=True):
                total.add_(gradient)


class PolicyUpdate:
    """Updates the policy; holds its optimiser."""

    def __init__(self, policy: Policy, config: PPOConfig, ranks: Ranks = ALONE) -> None:
        """Take over the policy's parameters."""
        self.policy, self.config = policy, config
        self._channel, self._batch_size = ranks.policy, ranks.share(config.batch_size)
        noise, groups = policy.noise_parameters(), [list(policy.network.parameters())]
        self.optimiser = FlatAdam(
            groups + [noise] if noise else groups, ties=policy.network.ties())
        self._other_half, other_gradient_of = self.optimiser.partial_gradient()
        self._gradient, self._other_gradient = (
            PolicyGradient(policy, config, gradient_of, self._batch_size)
            for gradient_of in (self.optimiser.gradient_of, other_gradient_of))

    @torch.inference_mode()
    def run(
        self, batch: Batch, orders: Sequence[Tensor], rates: Sequence[float], poll: Poll,
        entropy_coefficient: float, begin: Begin | None = None,
    ) -> PolicyDiagnostics:
        """Learn from each order of the samples, until the policy has moved too far.

        :param begin: computes half of each gradient; by default there are no halves.
        """
        config = self.config
        seen = self.policy.normaliser.of_many(batch.observation)
        log_ratio, entropy = torch.empty_like(batch.value), torch.empty_like(batch.value)
        minibatches = Minibatches(
            (seen, batch.action, batch.log_prob, batch.advantage), (log_ratio, entropy),
            self._batch_size, self._gradient.rows)
        losses, entropies, clipped, norms = [], [], [], []
        learnt_from = judged = 0
        kl = NAN
        for order in orders:
            *_, advantage = minibatches.shuffle(order)
            if config.normalise_advantages:
                minibatches.normalise_(advantage)
            learnt = stop = 0
            for start, stop, pieces in minibatches:
                poll()
                self._find_gradient(pieces, entropy_coefficient, begin)
                if config.target_kl and config.target_kl < (kl := self._divergence(
                        log_ratio[start:stop], poll)):
                    break
                self._channel.sum_(self.optimiser.gradient, poll)
                norms.append(self.optimiser.step(
                    rates, config.max_grad_norm, (stop - start) * self._channel.count))
                self.policy.constrain()
                learnt = stop
            ratio = log_ratio[:stop].exp()
            clipped.append(((ratio - 1).abs() > config.clip_range).sum())
            losses.append(clipped_objective(
                ratio[:learnt], advantage[:learnt], config.clip_range).sum())
            entropies.append(entropy[:learnt].sum())
            learnt_from, judged = learnt_from + learnt, judged + stop
            kl = self._divergence(log_ratio[start:stop], poll)
            if learnt < stop:
                break
        return PolicyDiagnostics(
            policy_loss=-_sum(losses) / learnt_from if learnt_from else NAN,
            entropy=_sum(entropies) / learnt_from if learnt_from else NAN,
            approx_kl=kl, clipfrac=_sum(clipped) / judged,
            grad_norm=sum(norms) / len(norms) if norms else NAN, updates=len(norms))

    def _find_gradient(
        self, pieces: Sequence[tuple[Tensor, ...]], entropy_coefficient: float,
        begin: Begin | None,
    ) -> None:
        """Set the optimiser's gradient to that of a minibatch; fill in the results."""
        self.optimiser.gradient.zero_()
        if begin is None:
            self._gradient.add(pieces, entropy_coefficient)
            return
        self._other_half.zero_()
        in_halves(
            begin, pieces, lambda half: self._gradient.add(half, entropy_coefficient),
            lambda half: self._other_gradient.add(half, entropy_coefficient))
        self.optimiser.gradient.add_(self._other_half)

    def _divergence(self, log_ratio: Tensor, poll: Poll) -> float:
        """Return the mean of r - 1 - log r, of all ranks."""
        return self._channel.mean([float((log_ratio.exp() - 1 - log_ratio).mean())], poll)[0]


def _sum(values: list[Tensor]) -> float:
    return float(torch.stack(values).sum())


def update(
    policy: PolicyUpdate,
    critic: CriticUpdate,
    batch: Batch,
    generator: torch.Generator,
    policy_rates: Sequence[float],
    critic_rate: float,
    train_policy: bool = True,
    poll: Poll = lambda: None,
    entropy_coefficient: float | None = None,
    train_critic: bool = True,
) -> Diagnostics:
    """Update policy and critic in place.

    On a CPU both run in parallel if there are enough threads, and each always has half of them:
    two threads that share every operation wait for each other all the time, and are slower than
    one on a busy machine. Without the critic, the policy's gradients are computed in two halves,
    each with half of the threads. One and two threads compute the same bits.

    With several ranks, each has the same number of samples. Gradients are averaged over all ranks,
    so that all take the same steps.

    :param policy: both have the settings; the policy's number of epochs applies to both.
    :param batch: on the device of both.
    :param generator: shuffles the samples.
    :param policy_rates: learning rates of the network and of the noise parameters, if any.
    :param train_policy: False trains the critic only.
    :param poll: called before each minibatch, or during it; may raise to abort the update.
    :param entropy_coefficient: weight of the entropy bonus, by default from the settings.
    :param train_critic: False trains the policy only.
    """
    device = batch.value.device
    orders = [torch.randperm(len(batch.value), generator=generator).to(device)
              for _ in range(policy.config.n_epochs)]

    if entropy_coefficient is None:
        entropy_coefficient = policy.config.entropy_coefficient

    def run_policy(poll: Poll, begin: Begin | None = None) -> PolicyDiagnostics:
        if not train_policy:
            return PolicyDiagnostics()
        return policy.run(batch, orders, policy_rates, poll, entropy_coefficient, begin)

    def run_critic(poll: Poll) -> float:
        return critic.run(batch, orders, critic_rate, poll) if train_critic else NAN

    if device.type != 'cpu':
        news, value_loss = run_policy(poll), run_critic(poll)
    elif train_critic:
        news, value_loss = both(run_policy, run_critic, poll)
    else:
        with second_thread() as begin:
            news, value_loss = run_policy(poll, begin), NAN
    return Diagnostics(
        value_loss=value_loss,
        explained_variance=explained_variance(batch.value, batch.target), **vars(news))
