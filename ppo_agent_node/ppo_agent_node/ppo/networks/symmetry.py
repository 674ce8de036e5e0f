# SPDX-License-Identifier: Apache-2.0
"""Networks that are equivariant: a mirrored observation gives the mirrored action.

The worlds have no left and right, and an observation and its mirror image are one experience, but
a perceptron knows nothing of that and learns a small bias to one side. Here the hidden units of
each layer come in groups, one unit for each symmetry, and the weights between layers are tied
(Cohen and Welling, 'Group equivariant convolutional networks', 2016; van der Pol et al., 'MDP
homomorphic networks', 2020). The weights stay those of an ordinary perceptron, as does a policy's
file; it is their first values and their gradients that are projected.

All symmetries here are signed permutations: (g v)[i] = sign[i] * v[source[i]].
"""
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

_AXIAL = ('spin_', 'rcs_')
"""Axial vectors, which a mirror reverses within its plane instead of across it."""
_LANDER_ODD = ('position_x', 'velocity_x', 'angle', 'angular_velocity', 'lateral')
_LANDER_PAIRS = {'left_contact': 'right_contact', 'right_contact': 'left_contact'}
_LANDER_ACTIONS = (0, 3, 2, 1)
"""Nothing, right engine, main engine, left engine."""


class Representation(NamedTuple):
    """How each of G symmetries acts on a vector of D entries."""

    source: Tensor
    """`(G, D)`, int64: the entry that moves to each place."""
    sign: Tensor
    """`(G, D)`, 1 or -1."""

    def average(self, vector: Tensor) -> Tensor:
        """Return the invariant part of vectors `(..., D)`."""
        return (vector[..., self.source] * self.sign).mean(-2)

    def unsigned(self) -> Representation:
        """Return how the symmetries act on magnitudes, such as standard deviations."""
        return Representation(self.source, torch.ones_like(self.sign))

    def on_weights(self, inputs: Representation) -> Representation:
        """Return how they act on a flat weight matrix from `inputs` to this vector."""
        wide = inputs.source.shape[1]
        index = self.source[:, :, None] * wide + inputs.source[:, None]
        sign = self.sign[:, :, None] * inputs.sign[:, None]
        return Representation(index.flatten(1), sign.flatten(1))


class Symmetry(NamedTuple):
    """A group of symmetries, and how it acts on the ends of a network."""

    kind: str
    inputs: Representation
    actions: Representation
    table: Tensor
    """`(G, G)`: symmetry i after symmetry j is symmetry `table[i, j]`."""

    @property
    def order(self) -> int:
        """G, the number of symmetries."""
        return len(self.table)

    def hidden(self, units: int) -> Representation:
        """Return the regular representation, repeated: each symmetry permutes whole groups.

        :raises ValueError: when the units do not divide among the symmetries.
        """
        if units % self.order:
            raise ValueError(
                f'hidden_sizes: got {units}, expected a multiple of {self.order} with symmetry: '
                f'{self.kind!r}')
        inverse = (self.table == 0).int().argmax(1)
        shift = self.table[inverse]  # (G, G): the entry that moves to each place
        starts = torch.arange(0, units, self.order)
        index = (starts[None, :, None] + shift[:, None, :]).flatten(1)
        return Representation(index, torch.ones(index.shape))

    def layers(
        self, hidden_sizes: Sequence[int], outputs: Representation,
    ) -> list[Representation]:
        """Return how the symmetries act on the units of each layer of a network."""
        return [self.inputs, *map(self.hidden, hidden_sizes), outputs]

    def check_closed(self, setting: str, places: Sequence[int], names: Sequence[str]) -> None:
        """Check that the symmetries exchange the selected observations among themselves only.

        :param places: of the selected observations among `names`.
        :raises ValueError: otherwise; names the setting that selects them.
        """
        moved = {int(place) for place in self.inputs.source[:, list(places)].flatten()}
        if missing := sorted(moved - set(places)):
            raise ValueError(
                f'{setting}: got {" ".join(names[place] for place in places)!r}, expected also '
                f'{", ".join(names[place] for place in missing)} with symmetry: {self.kind!r}')

    def invariant(self) -> Representation:
        """Return how they act on a number that all symmetries leave as it is."""
        return Representation(
            torch.zeros(self.order, 1, dtype=torch.int64), torch.ones(self.order, 1))


def _rocket_mirror(names: Sequence[str], plane: str) -> tuple[list[int], list[float]]:
    """Return the effect on named entries of a mirror across `x`, across `z` or across x = `z`."""
    swaps = {'x': 'z', 'z': 'x'} if plane == 'x=z' else {}
    index, sign = [], []
    for name in names:
        stem, _, axis = name.rpartition('_')
        if axis not in 'xyz' or not stem:
            index.append(names.index(name))
            sign.append(1.0)
            continue
        index.append(names.index(f'{stem}_{swaps.get(axis, axis)}'))
        value = -1.0 if axis == plane else 1.0
        sign.append(-value if any(part in name for part in _AXIAL) else value)
    return index, sign


def _lander_mirror(names: Sequence[str]) -> tuple[list[int], list[float]]:
    return ([names.index(_LANDER_PAIRS.get(name, name)) for name in names],
            [-1.0 if name in _LANDER_ODD else 1.0 for name in names])


def make_symmetry(
    kind: str, observation_names: Sequence[str], feature_names: Sequence[str],
    action_names: Sequence[str], action_count: int,
) -> Symmetry | None:
    """Return the symmetries of a world, None for none.

    :param kind: `none`; `mirrors`: across x and z (a lander: across x); `turns`: also across the
        plane x = z, which makes quarter turns about the vertical.
    :param action_count: number of discrete actions, 0 for continuous ones.
    """
    if kind == 'none':
        return None
    generators: list[list[tuple[list[int], list[float]]]]
    groups = (observation_names, feature_names, action_names)
    if 'angle' in observation_names:
        generators = [[_lander_mirror(names) for names in groups]]
        if action_count:
            generators[0][2] = (list(_LANDER_ACTIONS), [1.0] * action_count)
    else:
        planes = ('x', 'z', 'x=z') if kind == 'turns' else ('x', 'z')
        generators = [[_rocket_mirror(names, plane) for names in groups] for plane in planes]
    joined = [_joined(parts) for parts in generators]
    elements = _closure(joined)
    table = torch.tensor([
        [elements.index(_after(first, second)) for second in elements] for first in elements])
    whole = Representation(
        torch.tensor([index for index, _ in elements]),
        torch.tensor([sign for _, sign in elements]))
    inputs = len(observation_names) + len(feature_names)
    return Symmetry(
        kind, Representation(whole.source[:, :inputs], whole.sign[:, :inputs]),
        Representation(whole.source[:, inputs:] - inputs, whole.sign[:, inputs:]), table)


_Element = tuple[tuple[int, ...], tuple[float, ...]]


def _joined(parts: Sequence[tuple[list[int], list[float]]]) -> _Element:
    index: list[int] = []
    sign: list[float] = []
    for one, signs in parts:
        index += [place + len(sign) for place in one]
        sign += signs
    return tuple(index), tuple(sign)


def _after(first: _Element, second: _Element) -> _Element:
    """Return the effect of `second`, then `first`."""
    (index, sign), (before, signs) = first, second
    return (tuple(before[place] for place in index),
            tuple(one * signs[place] for one, place in zip(sign, index, strict=True)))


def _closure(generators: Sequence[_Element]) -> list[_Element]:
    """Return all products of the generators, the identity first."""
    size = len(generators[0][0])
    elements: list[_Element] = [(tuple(range(size)), (1.0,) * size)]
    for element in elements:  # grows
        for generator in generators:
            product = _after(generator, element)
            if product not in elements:
                elements.append(product)
    return elements
