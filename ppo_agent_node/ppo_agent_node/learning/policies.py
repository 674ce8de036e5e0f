# SPDX-License-Identifier: Apache-2.0
"""Policies: one interface for every kind of action, a Gaussian one and a categorical one."""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Sequence
from typing import Any
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch import nn
from torch.nn import functional

from ppo_agent_node.learning.config import NetworkConfig
from ppo_agent_node.learning.networks import Normaliser
from ppo_agent_node.learning.networks import mlp
from rocket_sim_node.worlds import WorldSpec

_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


class Likelihood(NamedTuple):
    """What a policy says of actions, given what its network said of the observations."""

    log_prob: Tensor
    """`(S,)`"""
    entropy: Tensor
    """nats, `(S,)`; a scalar where it is the same for all"""
    kept: Tensor
    """what the gradient needs again"""


class Policy(nn.Module):
    """What the learner asks of a policy, whatever the kind of its actions."""

    action_shape: tuple[int, ...]
    """Shape of one rocket's action: `(A,)` continuous, `()` discrete."""
    action_dtype: torch.dtype
    normaliser: Normaliser

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions `(N, *action_shape)` and their log-probabilities `(N,)`."""
        raise NotImplementedError

    @property
    def network(self) -> nn.Sequential:
        """The perceptron between normalised observations and the distribution."""
        raise NotImplementedError

    def output(self, observation: Tensor) -> Tensor:
        """Return what the network says of observations, `(S, K)`."""
        output: Tensor = self.network(self.normaliser(observation))
        return output

    def likelihood(self, output: Tensor, action: Tensor) -> Likelihood:
        """Return what outputs `(K, S)`, a row for each, say of actions `(S, *action_shape)`."""
        raise NotImplementedError

    def likelihood_gradient(
        self, found: Likelihood, action: Tensor, by_log_prob: Tensor, by_entropy: float,
    ) -> tuple[Tensor, list[Tensor]]:
        """Return a loss's gradient by the outputs, `(K, S)`, and by each noise parameter.

        :param found: what `likelihood` said of these actions.
        :param by_log_prob: the loss's gradient by each log-probability, `(S,)`.
        :param by_entropy: its gradient by each sample's entropy.
        """
        raise NotImplementedError

    def log_prob_entropy(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return log-probabilities `(S,)` of given actions and entropies `(S,)`, nats."""
        found = self.likelihood(self.output(observation).T, action)
        return found.log_prob, found.entropy.expand_as(found.log_prob)

    def mode(self, observation: Tensor) -> Tensor:
        """Return the likeliest actions `(N, *action_shape)`."""
        raise NotImplementedError

    def cloning_loss(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the loss, a scalar, of imitating actions `(S, *action_shape)`."""
        raise NotImplementedError

    def constrain(self, progress: float = 0.0) -> None:
        """Put parameters into the range that they have at a time of the run.

        :param progress: from 0 at the first iteration to 1 at the last.
        """

    def noise_parameters(self) -> list[nn.Parameter]:
        """Return the parameters that say how much to explore, which learn at their own rate."""
        return []

    def diagnostics(self) -> dict[str, float]:
        """Return numbers worth plotting."""
        return {}


class GaussianPolicy(Policy):
    """A normal distribution about a network's output, its deviation learnt, equal everywhere.

    Actions are sampled unbounded; the world clips what it flies.
    """

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        hidden_sizes: Sequence[int],
        generator: torch.Generator,
        log_std_init: float = -2.4,
        log_std_final: float = 2.0,
        log_std_floor: float = -20.0,
        activation: str = 'tanh',
    ) -> None:
        """Make a policy D -> hidden_sizes -> A whose first actions are near 0.

        The log standard deviation, learnt, begins at `log_std_init` and stays above its floor.
        With a `log_std_final` below the first value it also stays below a line from that to this.
        """
        super().__init__()
        self.action_shape = (action_size,)
        self.action_dtype = torch.float32
        self.normaliser = Normaliser(observation_size)
        self.mean = mlp(
            (observation_size, *hidden_sizes, action_size), 0.01, generator, activation)
        self.log_std = nn.Parameter(torch.full((action_size,), float(log_std_init)))
        self.log_std_init, self.log_std_final = log_std_init, log_std_final
        self.log_std_floor = log_std_floor

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions `(N, A)` and their log-probabilities `(N,)`."""
        mean = self.mode(observation)
        noise = torch.randn(mean.shape, generator=generator)
        action = mean + self.log_std.exp() * noise
        return action, self._log_prob(noise.T)

    @property
    def network(self) -> nn.Sequential:
        """What gives the means."""
        return self.mean

    def likelihood(self, output: Tensor, action: Tensor) -> Likelihood:
        """Return log-probabilities `(S,)` and the entropy, a scalar."""
        noise = (output - action.T) * (-self.log_std).exp()[:, None]
        entropy = (self.log_std + (0.5 + _HALF_LOG_TAU)).sum()
        return Likelihood(self._log_prob(noise), entropy, noise)

    def likelihood_gradient(
        self, found: Likelihood, action: Tensor, by_log_prob: Tensor, by_entropy: float,
    ) -> tuple[Tensor, list[Tensor]]:
        """Return the gradients by the means and by the log deviation.

        With z = (mean - a) / std: d log p / d mean = -z / std, d log p / d log std = z^2 - 1, and
        the entropy grows as the sum of the log deviations.
        """
        pull = found.kept * by_log_prob
        by_log_std = torch.linalg.vecdot(pull, found.kept)
        by_log_std += by_entropy * len(action) - by_log_prob.sum()
        return pull.mul_(-(-self.log_std).exp()[:, None]), [by_log_std]

    def _log_prob(self, noise: Tensor) -> Tensor:
        """Return the log-density `(S,)` of actions `noise` `(A, S)` deviations from the mean."""
        return -0.5 * noise.square().sum(0) - (self.log_std + _HALF_LOG_TAU).sum()

    def mode(self, observation: Tensor) -> Tensor:
        """Return the means `(N, A)`."""
        return self.output(observation)

    def cloning_loss(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the mean squared error; to overshoot an action that is at its bound is none."""
        mean = self.mode(observation)
        error = torch.where(action >= 1, mean.clamp_max(1), mean)
        error = torch.where(action <= -1, mean.clamp_min(-1), error) - action
        return error.square().mean()

    @torch.no_grad()
    def constrain(self, progress: float = 0.0) -> None:
        """Keep the log deviation above its floor and below its falling ceiling, if it has one."""
        self.log_std.clamp_min_(self.log_std_floor)
        if self.log_std_final < self.log_std_init:
            self.log_std.clamp_max_(
                self.log_std_init + progress * (self.log_std_final - self.log_std_init))

    def noise_parameters(self) -> list[nn.Parameter]:
        """Return the log standard deviation."""
        return [self.log_std]

    def diagnostics(self) -> dict[str, float]:
        """Return the mean log standard deviation."""
        return {'log_std': float(self.log_std.detach().mean())}


class CategoricalPolicy(Policy):
    """One of K actions, with probabilities that are the softmax of a network's output.

    Weights that are not finite are an error wherever an action is chosen: an action is a whole
    number, which nobody downstream could tell from a good one.
    """

    def __init__(
        self,
        observation_size: int,
        action_count: int,
        hidden_sizes: Sequence[int],
        generator: torch.Generator,
        activation: str = 'tanh',
    ) -> None:
        """Make a policy D -> hidden_sizes -> K whose first actions are nearly equally likely."""
        super().__init__()
        self.action_shape = ()
        self.action_dtype = torch.int64
        self.normaliser = Normaliser(observation_size)
        self.logits = mlp(
            (observation_size, *hidden_sizes, action_count), 0.01, generator, activation)

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions `(N,)` int64 and their log-probabilities `(N,)`.

        The Gumbel-max trick: argmax(log p - log(-log u)) has the probabilities p (Maddison,
        Tarlow and Minka, 'A* sampling', 2014). One uniform number for each action, so that the
        stream moves on alike whatever is drawn.

        :raises ValueError: when the network's output is not finite.
        """
        log_p = self._finite_log_p(observation)
        uniform = torch.rand(log_p.shape, generator=generator)
        # A u of 0 gives minus infinity, which merely is not drawn.
        action = (log_p - (-uniform.log()).log()).argmax(-1)
        return action, _picked(log_p, action)

    @property
    def network(self) -> nn.Sequential:
        """What gives the logits."""
        return self.logits

    def likelihood(self, output: Tensor, action: Tensor) -> Likelihood:
        """Return log-probabilities and entropies `(S,)`."""
        log_p = output.log_softmax(0)
        return Likelihood(
            log_p.gather(0, action[None])[0], -(log_p.exp() * log_p).sum(0), log_p)

    def likelihood_gradient(
        self, found: Likelihood, action: Tensor, by_log_prob: Tensor, by_entropy: float,
    ) -> tuple[Tensor, list[Tensor]]:
        """Return the gradient by the logits; there is no noise parameter.

        With H the entropy: d log p_a / d logit_k = [k = a] - p_k and
        d H / d logit_k = -p_k (log p_k + H).
        """
        log_p = found.kept
        error = (log_p + found.entropy).mul_(-by_entropy).sub_(by_log_prob).mul_(log_p.exp())
        return error.scatter_add_(0, action[None], by_log_prob[None]), []

    def mode(self, observation: Tensor) -> Tensor:
        """Return the likeliest actions `(N,)` int64; of equally likely ones the first.

        :raises ValueError: when the network's output is not finite.
        """
        return self._finite_log_p(observation).argmax(-1)

    def cloning_loss(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the cross entropy of actions `(S,)`, nats."""
        return functional.nll_loss(self._log_p(observation), action)

    def _log_p(self, observation: Tensor) -> Tensor:
        """Return the log-probabilities of all actions `(S, K)`."""
        return self.output(observation).log_softmax(-1)

    def _finite_log_p(self, observation: Tensor) -> Tensor:
        log_p = self._log_p(observation)
        bad = ~log_p.isfinite().all(-1)
        if bool(bad.any()):
            raise ValueError(
                f'policy: the probabilities of row {int(bad.nonzero()[0, 0])} are not finite')
        return log_p


def _picked(log_p: Tensor, action: Tensor) -> Tensor:
    """Return the entries `(S,)` of `(S, K)` that belong to actions `(S,)`."""
    return log_p.gather(-1, action[..., None])[..., 0]


def without_noise(policy: Policy) -> Callable[[NDArray[np.float32]], NDArray[Any]]:
    """Return the pilot that does what the policy finds likeliest, in NumPy."""

    @torch.inference_mode()
    def fly(observation: NDArray[np.float32]) -> NDArray[Any]:
        action: NDArray[Any] = policy.mode(torch.tensor(observation)).numpy()
        return action

    return fly


def make_policy(spec: WorldSpec, network: NetworkConfig, generator: torch.Generator) -> Policy:
    """Return a policy for a world's kind of action.

    :param network: its shape; what it says of the deviation is for continuous actions only.
    """
    if not spec.continuous:
        return CategoricalPolicy(
            spec.observation_size, spec.action_count, network.hidden_sizes, generator,
            network.activation)
    return GaussianPolicy(
        spec.observation_size, spec.action_size, network.hidden_sizes, generator,
        network.log_std_init, network.log_std_final, network.log_std_floor, network.activation)
