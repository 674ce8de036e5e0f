# SPDX-License-Identifier: Apache-2.0
"""Policy interface of the learner, for any kind of action."""
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch import nn

from ppo_agent_node.ppo.networks.mlp import Normaliser
from ppo_agent_node.ppo.networks.mlp import Perceptron
from ppo_agent_node.ppo.networks.mlp import quick


class Likelihood(NamedTuple):
    """Likelihood of actions under a policy, given the network's outputs."""

    log_prob: Tensor
    """`(S,)`."""
    entropy: Tensor
    """nats, `(S,)`; a scalar if it is the same for all."""
    kept: Tensor
    """Intermediate result for the gradient."""


class Policy(nn.Module):
    """Policy interface of the learner, for any kind of action."""

    action_shape: tuple[int, ...]
    """Shape of one rocket's action: `(A,)` continuous, `()` discrete."""
    action_dtype: torch.dtype
    normaliser: Normaliser
    noise_lasts = False
    """Whether the random numbers of a sampler serve any number of steps, not only T."""

    def sampler(
        self, log_prob: Tensor, generator: torch.Generator,
    ) -> Callable[[int, Tensor], Tensor]:
        """Draw all random numbers of T steps with N rockets; return a sampling function.

        Called with a step, from 0 to T - 1, and the observations `(N, D)`, it returns actions
        `(N, *action_shape)`. With `noise_lasts` it may be called again from step 0.

        :param log_prob: `(T, N)`, output for the log-probabilities of sampled actions.
        """
        raise NotImplementedError

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions `(N, *action_shape)` and their log-probabilities `(N,)`."""
        log_prob = torch.empty(1, len(observation))
        action = self.sampler(log_prob, generator)(0, observation)
        return action, log_prob[0]

    @property
    def network(self) -> Perceptron:
        """The perceptron between normalised observations and the distribution's parameters."""
        raise NotImplementedError

    def output(self, observation: Tensor) -> Tensor:
        """Return the network's outputs for observations, `(S, K)`."""
        output: Tensor = self.network(self.normaliser(observation))
        return output

    def quick_output(self) -> Callable[[Tensor], Tensor]:
        """Return a function for flight that computes `output` without gradients; see `quick`."""
        return quick(self.normaliser, self.network.without_gradients())

    def likelihood(self, output: Tensor, action: Tensor) -> Likelihood:
        """Return the likelihood of actions `(S, *action_shape)` given outputs `(K, S)`."""
        raise NotImplementedError

    def likelihood_gradient(
        self, found: Likelihood, action: Tensor, by_log_prob: Tensor, by_entropy: float,
    ) -> tuple[Tensor, list[Tensor]]:
        """Return a loss's gradient by the outputs, `(K, S)`, and by each noise parameter.

        :param found: the result of `likelihood` for these actions.
        :param by_log_prob: the loss's gradient by each log-probability, `(S,)`.
        :param by_entropy: its gradient by each sample's entropy.
        """
        raise NotImplementedError

    def log_prob_entropy(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return log-probabilities `(S,)` of given actions and entropies `(S,)`, nats."""
        found = self.likelihood(self.output(observation).T, action)
        return found.log_prob, found.entropy.expand_as(found.log_prob)

    def mode(self, observation: Tensor) -> Tensor:
        """Return the most likely actions `(N, *action_shape)`, as `most_likely` does."""
        return self.most_likely(self.output(observation))

    def most_likely(self, output: Tensor) -> Tensor:
        """Return the most likely actions `(N, *action_shape)` given outputs `(N, K)`."""
        raise NotImplementedError

    def imitation(
        self, output: Tensor, action: Tensor, huber_delta: float = 0.0, margin: float = 0.0,
    ) -> tuple[Tensor, Tensor]:
        """Return the imitation loss of outputs `(K, S)` for target actions `(S, *action_shape)`.

        :param huber_delta: errors of continuous actions count linearly beyond it; 0: nowhere.
        :param margin: targets of continuous actions at a bound are moved beyond it by this much.
        :return: its sum over the samples, and its gradient by the outputs `(K, S)`.
        """
        raise NotImplementedError

    def constrain(self, progress: float = 0.0) -> None:
        """Clamp parameters to their range at a point of the run.

        :param progress: from 0 at the first iteration to 1 at the last.
        """

    def noise_parameters(self) -> list[nn.Parameter]:
        """Return the parameters of the exploration noise, which have their own learning rate."""
        return []

    def diagnostics(self) -> dict[str, float]:
        """Return values for plotting."""
        return {}
