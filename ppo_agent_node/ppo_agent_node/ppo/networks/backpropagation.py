# SPDX-License-Identifier: Apache-2.0
"""Multilayer perceptrons forwards and backwards.

What autograd does for `networks.mlp`, by hand: no graph, the quickest library for each layer, and
so few samples at a time that what one leaves is still in the processor's cache when the next one
wants it.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ppo_agent_node.ppo.networks.dense import add_product
from ppo_agent_node.ppo.networks.dense import dense
from ppo_agent_node.ppo.networks.dense import product
from ppo_agent_node.ppo.networks.mlp import Perceptron

_CACHED_ROWS = 1024
"""Samples at a time on a CPU: what a layer of 256 units leaves of them, 1 MB, is still in a cache
when the next one wants it; with fewer, the operations' fixed costs tell."""


class _Layer(NamedTuple):
    weight: Tensor
    """`(outputs, inputs)`"""
    bias: Tensor
    weight_gradient: Tensor
    bias_gradient: Tensor


class Backpropagation:
    """Forward and backward pass of a network, for `rows` samples at a time at most."""

    rows: int

    def __init__(
        self, network: Perceptron, gradient_of: Callable[[Tensor], Tensor], most: int,
    ) -> None:
        """Take the network's layers.

        :param network: of `networks.mlp`; its parameters are read where they lie.
        :param gradient_of: where the gradient of a parameter is added.
        :param most: samples that anyone will want at a time.
        """
        *self._hidden, self._last = [
            _Layer(layer.weight.detach(), layer.bias.detach(),
                   gradient_of(layer.weight), gradient_of(layer.bias)) for layer in network.linear]
        self._activation = network.activation
        cpu = self._last.weight.device.type == 'cpu'
        self.rows = min(most, _CACHED_ROWS) if cpu else most
        self._inputs: list[Tensor] = []

    def forward(self, x: Tensor, out: Tensor | None = None) -> Tensor:
        """Return the outputs `(K, S)` for inputs `(S, D)`; S up to `rows`.

        A row for each output: what follows goes across a few outputs of many samples.

        :param out: where to write them.
        """
        self._inputs = [x]
        for layer in self._hidden:
            x = dense(x, layer.weight, layer.bias, self._activation)
            self._inputs.append(x)
        return torch.addmm(self._last.bias[:, None], self._last.weight, x.T, out=out)

    def backward(self, error: Tensor) -> None:
        """Add the gradients of all parameters, for the inputs of the last `forward`.

        :param error: `(K, S)`, the loss's gradient with respect to the outputs.
        """
        layers = [*self._hidden, self._last]
        for layer, x in zip(reversed(layers), reversed(self._inputs), strict=True):
            add_product(layer.weight_gradient, error, x)
            layer.bias_gradient.add_(error.sum(1))
            if x is not self._inputs[0]:
                below = product(error.T, layer.weight)
                if self._activation == 'tanh':
                    torch.ops.aten.tanh_backward.grad_input(below, x, grad_input=below)
                else:
                    below.mul_(x > 0)
                error = below.T
