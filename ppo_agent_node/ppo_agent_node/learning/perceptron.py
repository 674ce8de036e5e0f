# SPDX-License-Identifier: Apache-2.0
"""Multilayer perceptrons forwards and backwards in memory that is allocated once.

What autograd does for `networks.mlp`, by hand: no graph, no allocation, and so few samples at a
time that what one layer leaves is still in the processor's cache when the next one wants it.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch import nn

_CACHED_ROWS = 1024
"""Samples at a time on a CPU: what a layer of 256 units leaves of them, 1 MB, is still in a cache
when the next one wants it; with fewer, the operations' fixed costs tell."""


class _Layer(NamedTuple):
    weight: Tensor
    """`(outputs, inputs)`"""
    turned: Tensor
    """the same, `(inputs, outputs)`"""
    bias: Tensor
    weight_gradient: Tensor
    bias_gradient: Tensor


class _Memory(NamedTuple):
    """For a number of samples."""

    hidden: list[Tensor]
    """of each hidden layer, `(S, units)`, after its activation"""
    error: list[Tensor]
    """of each hidden layer, the loss's gradient, `(S, units)`"""
    ones: Tensor


class Perceptron:
    """Forward and backward pass of a network, for `rows` samples at a time at most."""

    rows: int

    def __init__(
        self, network: nn.Sequential, gradient_of: Callable[[Tensor], Tensor], most: int,
    ) -> None:
        """Allocate.

        :param network: of `networks.mlp`; its parameters are read where they lie.
        :param gradient_of: where the gradient of a parameter is added.
        :param most: samples that anyone will want at a time.
        """
        linear = [layer for layer in network if isinstance(layer, nn.Linear)]
        self._layers = [
            _Layer(layer.weight.detach(), layer.weight.detach().T, layer.bias.detach(),
                   gradient_of(layer.weight), gradient_of(layer.bias)) for layer in linear]
        self._tanh = any(isinstance(layer, nn.Tanh) for layer in network)
        device = self._layers[0].weight.device
        rows = self.rows = min(most, _CACHED_ROWS) if device.type == 'cpu' else most
        widths = [layer.out_features for layer in linear[:-1]]
        self._all = _Memory(
            [torch.empty(rows, width, device=device) for width in widths],
            [torch.empty(rows, width, device=device) for width in widths],
            torch.ones(rows, device=device))
        self._memories: dict[int, _Memory] = {}
        self._input = self._all.ones

    def _memory(self, rows: int) -> _Memory:
        if rows not in self._memories:
            self._memories[rows] = _Memory(
                [tensor[:rows] for tensor in self._all.hidden],
                [tensor[:rows] for tensor in self._all.error], self._all.ones[:rows])
        return self._memories[rows]

    def forward(self, x: Tensor, out: Tensor | None = None) -> Tensor:
        """Return the outputs `(K, S)` for inputs `(S, D)`; S up to `rows`.

        A row for each output: what follows goes across a few outputs of many samples.

        :param out: where to write them, instead of memory that is used again.
        """
        self._input = x
        for layer, hidden in zip(self._layers, self._memory(len(x)).hidden, strict=False):
            torch.addmm(layer.bias, x, layer.turned, out=hidden)
            if self._tanh:
                hidden.tanh_()
            else:
                hidden.relu_()
            x = hidden
        last = self._layers[-1]
        return torch.addmm(last.bias[:, None], last.weight, x.T, out=out)

    def backward(self, error: Tensor) -> None:
        """Add the gradients of all parameters, for the inputs of the last `forward`.

        :param error: `(K, S)`, the loss's gradient with respect to the outputs.
        """
        memory = self._memory(error.shape[1])
        for index in range(len(self._layers) - 1, -1, -1):
            layer = self._layers[index]
            x = memory.hidden[index - 1] if index else self._input
            layer.weight_gradient.addmm_(error, x)
            layer.bias_gradient.addmv_(error, memory.ones)
            if index:
                below = memory.error[index - 1]
                torch.mm(error.T, layer.weight, out=below)
                if self._tanh:
                    torch.ops.aten.tanh_backward.grad_input(below, x, grad_input=below)
                else:
                    below.mul_(x > 0)
                error = below.T
