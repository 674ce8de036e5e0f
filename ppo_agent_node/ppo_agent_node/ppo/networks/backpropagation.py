# SPDX-License-Identifier: Apache-2.0
"""Forward and backward pass of multilayer perceptrons, without autograd.

Computes what autograd does for `networks.mlp`, but without a graph, with the fastest library for
each layer, and in pieces small enough to stay in the processor's cache between layers.
"""
from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ppo_agent_node.ppo.networks.adam import GradientOf
from ppo_agent_node.ppo.networks.dense import add_product
from ppo_agent_node.ppo.networks.dense import dense
from ppo_agent_node.ppo.networks.dense import product
from ppo_agent_node.ppo.networks.mlp import Perceptron

_CACHED_ROWS = 1024
"""Samples per pass on a CPU: activations of a layer of 256 units, 1 MB, stay in the cache for the
next layer; with fewer samples, fixed costs per operation dominate."""


class _Layer(NamedTuple):
    weight: Tensor
    """`(outputs, inputs)`."""
    bias: Tensor
    weight_gradient: Tensor
    bias_gradient: Tensor


class Backpropagation:
    """Forward and backward pass of a network, for at most `rows` samples at a time."""

    rows: int

    def __init__(
        self, network: Perceptron, gradient_of: GradientOf, most: int, trained_layers: int = 0,
    ) -> None:
        """Prepare for the network's layers.

        :param network: of `networks.mlp`; its parameters are used in place.
        :param gradient_of: returns the tensor to which a parameter's gradient is added.
        :param most: maximum number of samples at a time.
        :param trained_layers: number of layers, from the last, that get gradients; 0: all.
        """
        *self._hidden, self._last = [
            _Layer(layer.weight.detach(), layer.bias.detach(),
                   gradient_of(layer.weight), gradient_of(layer.bias)) for layer in network.linear]
        self._activation = network.activation
        self._trained = [*self._hidden, self._last][-trained_layers:]
        cpu = self._last.weight.device.type == 'cpu'
        self.rows = min(most, _CACHED_ROWS) if cpu else most
        self._inputs: list[Tensor] = []

    def forward(self, x: Tensor, out: Tensor | None = None) -> Tensor:
        """Return the outputs `(K, S)` for inputs `(S, D)`; S up to `rows`.

        One row per output, as later operations process few outputs of many samples.

        :param out: memory for the result.
        """
        self._inputs = [x]
        for layer in self._hidden:
            x = dense(x, layer.weight, layer.bias, self._activation)
            self._inputs.append(x)
        return torch.addmm(self._last.bias[:, None], self._last.weight, x.T, out=out)

    def backward(self, error: Tensor) -> None:
        """Add the gradients of the trained layers, for the inputs of the last `forward`.

        :param error: `(K, S)`, the loss's gradient with respect to the outputs.
        """
        inputs = self._inputs[-len(self._trained):]
        for layer, x in zip(reversed(self._trained), reversed(inputs), strict=True):
            add_product(layer.weight_gradient, error, x)
            layer.bias_gradient.add_(error.sum(1))
            if x is not inputs[0]:
                below = product(error.T, layer.weight)
                if self._activation == 'tanh':
                    torch.ops.aten.tanh_backward.grad_input(below, x, grad_input=below)
                else:
                    below.mul_(x > 0)
                error = below.T
