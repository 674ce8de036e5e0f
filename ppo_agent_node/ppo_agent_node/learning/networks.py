# SPDX-License-Identifier: Apache-2.0
"""Policy and critic: separate multilayer perceptrons, one interface for every kind of action."""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch import nn

from rocket_sim_node.worlds import WorldSpec

_HALF_LOG_TAU = 0.5 * math.log(2 * math.pi)


def mlp(sizes: Sequence[int], last_gain: float, generator: torch.Generator) -> nn.Sequential:
    """Return linear layers with tanh between them.

    Orthogonal weights (Saxe et al., 'Exact solutions to the nonlinear dynamics of learning in
    deep linear neural networks', 2014) of gain sqrt(2), `last_gain` in the last layer, and no
    biases to begin with: implementation detail 2 of Huang et al., 'The 37 implementation details
    of proximal policy optimization', 2022.

    :param sizes: units from input to output.
    """
    layers: list[nn.Module] = []
    for index, (inputs, outputs) in enumerate(zip(sizes, sizes[1:], strict=False)):
        last = index == len(sizes) - 2
        # Made without memory first: nn.Linear's own initialisation draws from torch's global
        # generator.
        linear = nn.Linear(inputs, outputs, device='meta').to_empty(device='cpu')
        nn.init.orthogonal_(linear.weight, last_gain if last else math.sqrt(2), generator)
        nn.init.zeros_(linear.bias)
        layers += [linear] if last else [linear, nn.Tanh()]
    return nn.Sequential(*layers)


class Normaliser(nn.Module):
    """Brings observations into a range that a network resolves well, by fixed numbers.

    Entries with a `width` are bent first, asinh(x / width): linear within the width and
    logarithmic beyond, so that heights of 5 cm and of 200 m are both seen well. Then all get mean
    0 and standard deviation 1.
    """

    width: Tensor
    mean: Tensor
    scale: Tensor

    def __init__(self, size: int) -> None:
        """Make one that changes nothing."""
        super().__init__()
        self.register_buffer('width', torch.zeros(size))
        self.register_buffer('mean', torch.zeros(size))
        self.register_buffer('scale', torch.ones(size))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the observations `(..., D)`, normalised."""
        return (self._bend(observation) - self.mean) * self.scale

    def _bend(self, observation: Tensor) -> Tensor:
        bends = self.width > 0
        bent = torch.asinh(observation / torch.where(bends, self.width, 1.0))
        return torch.where(bends, bent, observation)

    def fit(self, observation: Tensor, least: float = 1e-3) -> None:
        """Take mean and deviation from samples `(S, D)`; deviations below `least` count as it."""
        bent = self._bend(observation)
        self.mean.copy_(bent.mean(0))
        self.scale.copy_(1 / bent.std(0).clamp_min(least))

    def copy_from(self, other: Normaliser) -> None:
        """Take the numbers from another."""
        self.load_state_dict(other.state_dict())


class Policy(nn.Module):
    """What the learner asks of a policy, whatever the kind of its actions."""

    action_shape: tuple[int, ...]
    """Shape of one rocket's action: `(A,)` continuous, `()` discrete."""
    action_dtype: torch.dtype
    normaliser: Normaliser

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions `(N, *action_shape)` and their log-probabilities `(N,)`."""
        raise NotImplementedError

    def log_prob_entropy(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return log-probabilities `(S,)` of given actions and entropies `(S,)`, nats."""
        raise NotImplementedError

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
    ) -> None:
        """Make a policy D -> hidden_sizes -> A whose first actions are near 0.

        The log standard deviation, learnt, begins at `log_std_init` and stays above its floor.
        With a `log_std_final` below the first value it also stays below a line from that to this.
        """
        super().__init__()
        self.action_shape = (action_size,)
        self.action_dtype = torch.float32
        self.normaliser = Normaliser(observation_size)
        self.mean = mlp((observation_size, *hidden_sizes, action_size), 0.01, generator)
        self.log_std = nn.Parameter(torch.full((action_size,), float(log_std_init)))
        self.log_std_init, self.log_std_final = log_std_init, log_std_final
        self.log_std_floor = log_std_floor

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return actions `(N, A)` and their log-probabilities `(N,)`."""
        mean = self.mode(observation)
        noise = torch.randn(mean.shape, generator=generator)
        action = mean + self.log_std.exp() * noise
        return action, self._log_prob(noise)

    def log_prob_entropy(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return log-probabilities and entropies `(S,)`."""
        noise = (action - self.mode(observation)) * (-self.log_std).exp()
        entropy = (self.log_std + 0.5 + _HALF_LOG_TAU).sum()
        return self._log_prob(noise), entropy.expand(len(noise))

    def _log_prob(self, noise: Tensor) -> Tensor:
        """Return the log-density `(S,)` of actions that are `noise` deviations from the mean."""
        return (-0.5 * noise.square() - self.log_std - _HALF_LOG_TAU).sum(-1)

    def mode(self, observation: Tensor) -> Tensor:
        """Return the means `(N, A)`."""
        mean: Tensor = self.mean(self.normaliser(observation))
        return mean

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


class Critic(nn.Module):
    """Estimates the return to come, in the learner's units (reward times reward_scale)."""

    def __init__(
        self, observation_size: int, hidden_sizes: Sequence[int], generator: torch.Generator,
    ) -> None:
        """Make a critic D -> hidden_sizes -> 1."""
        super().__init__()
        self.normaliser = Normaliser(observation_size)
        self.value = mlp((observation_size, *hidden_sizes, 1), 1.0, generator)

    def forward(self, observation: Tensor) -> Tensor:
        """Return the values `(N,)` of observations `(N, D)`."""
        value: Tensor = self.value(self.normaliser(observation))
        return value[..., 0]


def without_noise(policy: Policy) -> Callable[[NDArray[np.float32]], NDArray[Any]]:
    """Return the pilot that does what the policy finds likeliest, in NumPy."""

    @torch.inference_mode()
    def fly(observation: NDArray[np.float32]) -> NDArray[Any]:
        action: NDArray[Any] = policy.mode(torch.tensor(observation)).numpy()
        return action

    return fly


def make_policy(
    spec: WorldSpec, hidden_sizes: Sequence[int], generator: torch.Generator, **options: Any,
) -> Policy:
    """Return a policy for a world's kind of action.

    :param options: those of the kind of policy, such as `log_std_init`.
    :raises ValueError: when no policy here acts in such a world.
    """
    if not spec.continuous:
        raise ValueError(f'world {spec.name!r} has discrete actions, expected continuous ones')
    return GaussianPolicy(
        spec.observation_size, spec.action_size, hidden_sizes, generator, **options)
