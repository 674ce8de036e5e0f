# SPDX-License-Identifier: Apache-2.0
"""Adam optimiser over parameters in one contiguous tensor.

Kingma and Ba, 'Adam: a method for stochastic optimization', 2015, algorithm 1, as in
torch.optim.Adam. A step takes a few operations regardless of the number of parameters, as does the
gradient norm; torch's own optimiser spends more time on iterating over a small network's
parameters than on the update.
"""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence

import torch
from torch import Tensor
from torch import nn

from ppo_agent_node.ppo.networks.symmetry import Representation
from ppo_agent_node.runs.tensor_file import Tensors

GradientOf = Callable[[Tensor], Tensor]
"""Returns the tensor for a parameter's gradient, of the same shape."""
_ALIGNED = 16
"""Alignment of parameters, in numbers (64 bytes), for fast matrix products."""


class FlatAdam:
    """Moves parameters and their gradients into contiguous memory, and optimises them.

    Only their storage changes: parameters keep their values and identity.
    """

    gradient: Tensor
    """Of all parameters, flat. The caller zeroes it and accumulates gradients in the views of
    `gradient_of`."""

    def __init__(
        self,
        groups: Sequence[Sequence[nn.Parameter]],
        betas: tuple[float, float] = (0.9, 0.999),
        epsilon: float = 1e-5,
        ties: Mapping[Tensor, Representation] | None = None,
    ) -> None:
        """Take over parameters, in groups that each have a learning rate.

        :param ties: symmetries of flat parameters: gradients are projected onto the invariant
            subspace, so that invariant parameters stay invariant, up to rounding.
        """
        self._betas, self._epsilon = betas, epsilon
        self._parameters = [parameter for group in groups for parameter in group]
        places, ends = [], []
        size = 0
        for group in groups:
            for parameter in group:
                places.append(size)
                size += -(-parameter.numel() // _ALIGNED) * _ALIGNED
            ends.append(size)
        device = self._parameters[0].device
        values, self.gradient, self._mean, self._square, self._work = (
            torch.zeros(size, device=device) for _ in range(5))
        self._steps = 0
        self._groups = [
            tuple(flat[start:end] for flat in (values, self._mean, self._work))
            for start, end in zip([0, *ends], ends, strict=False)]

        self._places = places
        self._gradients = self._views_by_parameter(self.gradient)
        self._tied = None if not ties else _joined(ties, self._parameters, places, size, device)
        self._state = list(zip(self._views(self._mean), self._views(self._square), strict=True))
        with torch.no_grad():
            for parameter, view in zip(self._parameters, self._views(values), strict=True):
                view.copy_(parameter)
                parameter.data = view

    def gradient_of(self, parameter: Tensor) -> Tensor:
        """Return the view for a parameter's gradient, of the same shape."""
        return self._gradients[id(parameter)]

    def partial_gradient(self) -> tuple[Tensor, GradientOf]:
        """Return memory for another gradient, flat, and the views of it by parameter."""
        flat = torch.zeros_like(self.gradient)
        views = self._views_by_parameter(flat)
        return flat, lambda parameter: views[id(parameter)]

    def _views(self, flat: Tensor) -> list[Tensor]:
        return [flat[place:place + parameter.numel()].view_as(parameter)
                for place, parameter in zip(self._places, self._parameters, strict=True)]

    def _views_by_parameter(self, flat: Tensor) -> dict[int, Tensor]:
        return {id(parameter): view
                for parameter, view in zip(self._parameters, self._views(flat), strict=True)}

    def step(self, rates: Sequence[float], max_norm: float, count: int) -> float:
        """Update the parameters with the mean gradient of `count` samples.

        :param rates: learning rate of each group.
        :param max_norm: maximum norm of the mean gradient, which is scaled down beyond it, as by
            torch.nn.utils.clip_grad_norm_.
        :param count: number of samples whose gradients were summed.
        :return: the norm before clipping.
        """
        if self._tied is not None:
            self.gradient.copy_(self._tied.average(self.gradient))
        norm = float(torch.linalg.vector_norm(self.gradient)) / count
        # A NaN norm must propagate to the parameters, where it is detected.
        scale = (max_norm / (norm + 1e-6) if not norm + 1e-6 < max_norm else 1.0) / count
        first, second = self._betas
        self._steps += 1
        self._mean.mul_(first).add_(self.gradient, alpha=(1 - first) * scale)
        self._square.mul_(second).addcmul_(
            self.gradient, self.gradient, value=(1 - second) * scale**2)
        # Dividing both by the bias correction of the root saves an operation.
        correction = math.sqrt(1 - second**self._steps)
        torch.sqrt(self._square, out=self._work)
        self._work.add_(self._epsilon * correction)
        for rate, (values, mean, root) in zip(rates, self._groups, strict=True):
            values.addcdiv_(mean, root, value=-rate * correction / (1 - first**self._steps))
        return norm

    def state_dict(self) -> Tensors:
        """Return its state by name; all but the number of steps are views."""
        return {'steps': torch.tensor(self._steps)} | {
            f'{index}.{name}': tensor
            for index, pair in enumerate(self._state)
            for name, tensor in zip(('exp_avg', 'exp_avg_sq'), pair, strict=True)}

    def load_state_dict(self, tensors: Tensors) -> None:
        """Restore the result of `state_dict`, from any device."""
        for name, tensor in self.state_dict().items():
            tensor.copy_(tensors[name])
        self._steps = int(tensors['steps'])


def _joined(
    ties: Mapping[Tensor, Representation], parameters: Sequence[nn.Parameter],
    places: Sequence[int], size: int, device: torch.device,
) -> Representation:
    """Return how symmetries act on all parameters, flat, with the gaps between them."""
    order = len(next(iter(ties.values())).source)
    index = torch.arange(size).repeat(order, 1)
    sign = torch.ones(order, size)
    for place, parameter in zip(places, parameters, strict=True):
        if parameter in ties:
            part = slice(place, place + parameter.numel())
            index[:, part] = ties[parameter].source + place
            sign[:, part] = ties[parameter].sign
    return Representation(index.to(device), sign.to(device))
