# SPDX-License-Identifier: Apache-2.0
"""Multilayer perceptrons, observation normaliser and critic."""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor
from torch import nn
from torch.nn import functional

from ppo_agent_node.ppo.networks.dense import dense
from ppo_agent_node.ppo.networks.features import DescentFeatures
from ppo_agent_node.ppo.networks.features import asinh
from ppo_agent_node.ppo.networks.symmetry import Representation
from ppo_agent_node.ppo.networks.symmetry import Symmetry
from ppo_agent_node.threads import tensor_threads

_PIECE = 16_384
"""Samples normalised at a time: fewer cost more calls, more do not fit the cache."""
_ACTIVATIONS: dict[str, type[nn.Module]] = {'tanh': nn.Tanh, 'relu': nn.ReLU}


class Perceptron(nn.Sequential):
    """Linear layers with an activation between them.

    Autograd processes them one by one. Without gradients, `dense` computes each together with its
    activation, faster and equal except for the last bits.
    """

    symmetry: Sequence[Representation] = ()
    """How the symmetries act on the units of each layer, from the inputs; empty: none."""

    def ties(self) -> dict[Tensor, Representation]:
        """Return how the symmetries act on each parameter, flat."""
        return {
            parameter: found for layer, (inputs, outputs) in zip(
                self.linear, pairwise(self.symmetry), strict=bool(self.symmetry))
            for parameter, found in (
                (layer.weight, outputs.on_weights(inputs)), (layer.bias, outputs))}

    @property
    def linear(self) -> list[nn.Linear]:
        """Its linear layers from input to output."""
        return [layer for layer in self if isinstance(layer, nn.Linear)]

    @property
    def activation(self) -> str:
        """Name of the activation, `tanh` if there is only one layer."""
        return 'relu' if any(isinstance(layer, nn.ReLU) for layer in self) else 'tanh'

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs `(..., K)` for inputs `(..., D)`."""
        if not torch.is_grad_enabled():
            return self.without_gradients()(x)
        for layer in self:
            x = layer(x)
        return x

    def without_gradients(self) -> Callable[[Tensor], Tensor]:
        """Return a function that computes these layers, for calls without gradients."""
        hidden, last = self.parts_without_gradients()
        return lambda x: last(hidden(x))

    def parts_without_gradients(
        self,
    ) -> tuple[Callable[[Tensor], Tensor], Callable[[Tensor], Tensor]]:
        """Return two functions, for the hidden layers and for the last layer.

        The first maps inputs `(..., D)` to the units of the last hidden layer `(..., H)`, the
        second maps these to the outputs `(..., K)`. They are for calls without gradients.
        """
        *before, output = [(layer.weight, layer.bias) for layer in self.linear]
        activation = self.activation

        def hidden(x: Tensor) -> Tensor:
            for weight, bias in before:
                x = dense(x, weight, bias, activation)
            return x

        def last(h: Tensor) -> Tensor:
            return functional.linear(h, *output)

        return hidden, last


def mlp(
    sizes: Sequence[int], last_gain: float, generator: torch.Generator, activation: str = 'tanh',
    symmetry: Sequence[Representation] = (),
) -> Perceptron:
    """Return an untrained perceptron.

    Orthogonal weights (Saxe et al., 'Exact solutions to the nonlinear dynamics of learning in
    deep linear neural networks', 2014) of gain sqrt(2), `last_gain` in the last layer, and zero
    biases: implementation detail 2 of Huang et al., 'The 37 implementation details of proximal
    policy optimization', 2022.

    :param sizes: units from input to output.
    :param activation: `tanh` or `relu`.
    :param symmetry: how symmetries act on the units of each layer, inputs and outputs included;
        the network is equivariant, with weights of the same size.
    """
    between = _ACTIVATIONS[activation]
    layers: list[nn.Module] = []
    for index, (inputs, outputs) in enumerate(zip(sizes, sizes[1:], strict=False)):
        last = index == len(sizes) - 2
        # nn.Linear's own initialisation would draw from torch's global generator.
        with torch.random.fork_rng(devices=[]):
            linear = nn.Linear(inputs, outputs)
        # Two threads would round the decomposition differently.
        with tensor_threads(1):
            nn.init.orthogonal_(linear.weight, last_gain if last else math.sqrt(2), generator)
        nn.init.zeros_(linear.bias)
        layers += [linear] if last else [linear, between()]
    network = Perceptron(*layers)
    network.symmetry = symmetry
    with torch.no_grad():
        for parameter, tie in network.ties().items():
            # A mean of G independent numbers is smaller by the root of G.
            tied = tie.average(parameter.flatten()) * math.sqrt(len(tie.source))
            parameter.copy_(tied.view_as(parameter))
    return network


class Normaliser(nn.Module):
    """Normalises observations by fixed numbers.

    Entries with a `width` are first compressed, asinh(x / width): linear within the width and
    logarithmic beyond, so that heights of 5 cm and of 200 m are both resolved. The features, if
    any, are appended. Then all are normalised to mean 0 and standard deviation 1; hidden entries
    have scale 0 and become 0.
    """

    width: Tensor
    mean: Tensor
    scale: Tensor

    def __init__(
        self, size: int, features: DescentFeatures | None = None,
        symmetry: Symmetry | None = None,
    ) -> None:
        """Create the identity for D = `size` entries, with F features appended.

        :param symmetry: keeps what it fits to samples as these symmetries need it.
        """
        super().__init__()
        self._inputs = symmetry and symmetry.inputs
        self.features = features
        self.size = size + (features.count if features else 0)
        """D + F, number of output entries."""
        self.register_buffer('width', torch.zeros(size))
        self.register_buffer('mean', torch.zeros(self.size))
        self.register_buffer('scale', torch.ones(self.size))
        if features:
            self.scale[size:] = features.first_scale

    def forward(self, observation: Tensor) -> Tensor:
        """Return observations `(..., D)` and their features, normalised, `(..., D + F)`."""
        return (self._bend(observation) - self.mean) * self.scale

    def of_many(self, observation: Tensor) -> Tensor:
        """Return the same for many samples `(S, D)`, in less time and memory.

        On a CPU, in pieces whose intermediate results stay in the cache.
        """
        if observation.device.type != 'cpu':
            return self.forward(observation)
        found = torch.empty(len(observation), self.size)
        with tensor_threads(1):
            for piece, out in zip(
                    observation.split(_PIECE), found.split(_PIECE), strict=True):
                out.copy_(self.forward(piece))
        return found

    def _bend(self, observation: Tensor) -> Tensor:
        # Only these columns, because asinh takes longer than the rest.
        bends = self.width.nonzero()[:, 0]
        bent = asinh(observation[..., bends] / self.width[bends])
        return self._append(observation, observation.index_copy(-1, bends, bent))

    def _append(self, observation: Tensor, bent: Tensor) -> Tensor:
        if self.features is None:
            return bent
        return torch.cat((bent, self.features(observation)), -1)

    def hide(self, column: int) -> None:
        """Fix an observation's normalised value at 0, permanently."""
        self.scale[column] = 0.0

    def fit(self, observation: Tensor, least: float = 1e-3) -> None:
        """Set mean and deviation from samples `(S, D)`; deviations are at least `least`."""
        bent = self._bend(observation)
        mean, deviation = bent.mean(0), bent.std(0)
        if self._inputs is not None:
            mean = self._inputs.average(mean)
            square = (bent - mean).square().mean(0)
            deviation = self._inputs.unsigned().average(square).sqrt()
        self.mean.copy_(mean)
        hidden = self.scale == 0
        self.scale.copy_(1 / deviation.clamp_min(least)).masked_fill_(hidden, 0.0)

    def copy_from(self, other: Normaliser) -> None:
        """Copy another's numbers, but keep this one's hidden entries."""
        hidden = self.scale == 0
        self.load_state_dict(other.state_dict())
        self.scale.masked_fill_(other.scale == 0, 1.0).masked_fill_(hidden, 0.0)


def quick(
    normaliser: Normaliser, layers: Callable[[Tensor], Tensor],
) -> Callable[[Tensor], Tensor]:
    """Return a function that computes `layers(normaliser(x))` bit for bit, with less overhead.

    In flight a batch is a few hundred observations, for which module calls take as long as the
    arithmetic. The function uses the current values of the weights, but not parameters that
    replace them. It takes from now which entries have a `width`, and the scales of the features.
    The outputs are tensors of PyTorch's inference mode: they take no part in gradients.

    :param layers: what `Perceptron.without_gradients` or one of its parts computes.
    """
    bends = [(int(k), normaliser.width[k]) for k in normaliser.width.nonzero()[:, 0]]
    mean, scale = normaliser.mean, normaliser.scale
    features = normaliser.features and normaliser.features.in_flight()

    @torch.inference_mode()
    def output(observation: Tensor) -> Tensor:
        x = observation.clone() if bends else observation
        for k, width in bends:
            x[..., k] = asinh(x[..., k] / width)
        if features is not None:
            x = torch.cat((x, features(observation)), -1).sub_(mean)
        else:
            x = x.sub_(mean) if bends else x - mean
        x.mul_(scale)
        return layers(x)

    return output


class Critic(nn.Module):
    """Estimates the return, in the learner's units (reward times reward_scale)."""

    def __init__(
        self,
        observation_size: int,
        hidden_sizes: Sequence[int],
        generator: torch.Generator,
        activation: str = 'tanh',
        features: DescentFeatures | None = None,
        symmetry: Symmetry | None = None,
    ) -> None:
        """Create a critic D -> hidden_sizes -> 1, optionally with features."""
        super().__init__()
        self.normaliser = Normaliser(observation_size, features, symmetry)
        self.value = mlp(
            (self.normaliser.size, *hidden_sizes, 1), 1.0, generator, activation,
            () if symmetry is None else symmetry.layers(hidden_sizes, symmetry.invariant()))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the values `(N,)` of observations `(N, D)`."""
        value: Tensor = self.value(self.normaliser(observation))
        return value[..., 0]
