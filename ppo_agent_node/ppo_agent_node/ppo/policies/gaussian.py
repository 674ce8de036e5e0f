# SPDX-License-Identifier: Apache-2.0
"""Gaussian policy for continuous actions: a normal distribution around a network's output."""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Sequence

import torch
from torch import Tensor
from torch import nn
from torch.nn import functional

from ppo_agent_node.ppo.networks.features import DescentFeatures
from ppo_agent_node.ppo.networks.mlp import Normaliser
from ppo_agent_node.ppo.networks.mlp import Perceptron
from ppo_agent_node.ppo.networks.mlp import mlp
from ppo_agent_node.ppo.networks.mlp import quick
from ppo_agent_node.ppo.networks.symmetry import Symmetry
from ppo_agent_node.ppo.policies.base import Likelihood
from ppo_agent_node.ppo.policies.base import Policy

_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


class GaussianPolicy(Policy):
    """Normal distribution around a network's output, with a learned, state-independent deviation.

    Actions are sampled unbounded; the world clips them.
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
        features: DescentFeatures | None = None,
        symmetry: Symmetry | None = None,
        exploration: str = 'independent',
    ) -> None:
        """Create a policy D -> hidden_sizes -> A whose initial actions are near 0.

        The learned log standard deviation begins at `log_std_init` and stays above its floor. If
        `log_std_final` is below the initial value, it is also clamped, after each update, below a
        line from the initial to the final value.

        :param exploration: how the noise of successive steps is related; see `sampler`.
        """
        super().__init__()
        self.action_shape = (action_size,)
        self.action_dtype = torch.float32
        self.normaliser = Normaliser(observation_size, features, symmetry)
        self.mean = mlp(
            (self.normaliser.size, *hidden_sizes, action_size), 0.01, generator, activation,
            () if symmetry is None else symmetry.layers(hidden_sizes, symmetry.actions))
        self.log_std = nn.Parameter(torch.full((action_size,), float(log_std_init)))
        self.log_std_init, self.log_std_final = log_std_init, log_std_final
        self.log_std_floor = log_std_floor
        self.noise_lasts = exploration == 'state_dependent'

    @torch.no_grad()
    def sampler(
        self, log_prob: Tensor, generator: torch.Generator,
    ) -> Callable[[int, Tensor], Tensor]:
        """Return a function that samples actions `(N, A)`; see :class:`Policy`.

        With independent exploration, each step has its own noise. With state-dependent
        exploration the noise is a linear function of the last hidden layer h, drawn once for each
        rocket: std W h / |h|, with W `(A, H)` standard normal. Similar states get similar noise,
        so each rocket flies a slightly different policy. In a given state the noise has the same
        distribution as independent noise, and the log-probability is the one of that single
        action. A simplification of gSDE (Raffin, Kober and Stulp, 'Smooth exploration for robotic
        reinforcement learning', 2021): one deviation for each action instead of one for each
        feature and action.
        """
        if self.noise_lasts:
            return self._state_dependent(log_prob, generator)
        noise = torch.randn(*log_prob.shape, len(self.log_std), generator=generator)
        log_prob.copy_(self._log_prob(noise.movedim(-1, 0)))
        noise *= self.log_std.exp()
        mean = self.quick_output()

        @torch.inference_mode()
        def sample(step: int, observation: Tensor) -> Tensor:
            return mean(observation).add_(noise[step])

        return sample

    def _state_dependent(
        self, log_prob: Tensor, generator: torch.Generator,
    ) -> Callable[[int, Tensor], Tensor]:
        hidden, last = self.mean.parts_without_gradients()
        hidden = quick(self.normaliser, hidden)
        deviation = self.log_std.exp()
        weights = torch.randn(
            log_prob.shape[1], len(deviation), self.mean.linear[-1].in_features,
            generator=generator)

        @torch.inference_mode()
        def sample(step: int, observation: Tensor) -> Tensor:
            h = hidden(observation)
            noise = torch.linalg.vecdot(weights, functional.normalize(h)[:, None])
            log_prob[step] = self._log_prob(noise.T)
            return last(h).add_(noise.mul_(deviation))

        return sample

    @property
    def network(self) -> Perceptron:
        """The perceptron that outputs the means."""
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
        """Return the log-density `(...)` of actions `noise` `(A, ...)` deviations off the mean."""
        return -0.5 * noise.square().sum(0) - (self.log_std + _HALF_LOG_TAU).sum()

    def most_likely(self, output: Tensor) -> Tensor:
        """Return the means `(N, A)`, which are the outputs."""
        return output

    def imitation(
        self, output: Tensor, action: Tensor, huber_delta: float = 0.0, margin: float = 0.0,
    ) -> tuple[Tensor, Tensor]:
        """Return the squared error, mean over the entries of an action, and its gradient.

        With a `huber_delta` d it is Huber's loss, 2 d |e| - d^2 beyond d (Huber, 'Robust
        estimation of a location parameter', 1964): where a pilot switches between bounds, an error
        of one step in time is large, and would dominate the small errors that decide a landing.

        Overshooting an action at its bound is not an error, as the world clips it. With a margin
        the target lies beyond the bound, so that small errors do not leave it.
        """
        wanted = action.T
        most, least = wanted >= 1, wanted <= -1
        if margin:
            wanted = wanted + margin * (most.to(wanted.dtype) - least.to(wanted.dtype))
        error = output - wanted
        error.masked_fill_(most & (error > 0) | least & (error < 0), 0.0)
        if huber_delta:
            near = error.clamp(-huber_delta, huber_delta)
            loss = (near * (2 * error - near)).sum() / len(output)
            return loss, near * (2 / len(output))
        return error.square().sum() / len(output), error * (2 / len(output))

    @torch.no_grad()
    def constrain(self, progress: float = 0.0) -> None:
        """Clamp the log deviation above its floor and below its falling ceiling, if it has one."""
        if self.log_std_final < self.log_std_init:
            self.log_std.clamp_max_(
                self.log_std_init + progress * (self.log_std_final - self.log_std_init))
        self.log_std.clamp_min_(self.log_std_floor)

    def noise_parameters(self) -> list[nn.Parameter]:
        """Return the log standard deviation."""
        return [self.log_std]

    def diagnostics(self) -> dict[str, float]:
        """Return the mean log standard deviation."""
        return {'log_std': float(self.log_std.detach().mean())}
