# SPDX-License-Identifier: Apache-2.0
"""Samples in an epoch's order, split into minibatches and cache-sized pieces."""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


class Minibatch(NamedTuple):
    """Samples of one optimiser step."""

    start: int
    stop: int
    """Slice bounds of the minibatch in the order of the epoch."""
    pieces: list[tuple[Tensor, ...]]
    """Views of fields and results, at most `rows` samples each."""


class Minibatches:
    """Memory of an epoch's samples and views of it, created once per update.

    Samples are gathered once for a whole epoch, so that a minibatch is contiguous memory and needs
    no gathering of its own.
    """

    def __init__(
        self, fields: Sequence[Tensor], results: Sequence[Tensor], size: int, rows: int,
    ) -> None:
        """Allocate.

        :param fields: `(S, ...)`, inputs of each sample, in the order of the roll-out.
        :param results: `(S, ...)`, outputs of an epoch, in the epoch's order.
        :param size: samples of a minibatch; the last one may be smaller.
        :param rows: maximum samples of a piece.
        """
        self._fields, self._size = fields, size
        self._shuffled = tuple(torch.empty_like(field) for field in fields)
        self._count = len(fields[0])
        everything = (*self._shuffled, *results)
        self._minibatches = []
        for start in range(0, self._count, size):
            stop = min(start + size, self._count)
            parts = -(-(stop - start) // rows)
            even = -(-(stop - start) // parts)
            self._minibatches.append(Minibatch(start, stop, list(zip(
                *(tensor[start:stop].split(even) for tensor in everything), strict=True))))

    def __iter__(self) -> Iterator[Minibatch]:
        """Iterate over the minibatches in order."""
        return iter(self._minibatches)

    def shuffle(self, order: Tensor) -> tuple[Tensor, ...]:
        """Gather the fields in an order `(S,)` and return them."""
        for field, shuffled in zip(self._fields, self._shuffled, strict=True):
            torch.index_select(field, 0, order, out=shuffled)
        return self._shuffled

    def normalise_(self, values: Tensor) -> None:
        """Normalise values `(S,)` of each minibatch to mean 0 and deviation 1, in place.

        A minibatch of one sample is left unchanged.
        """
        whole = self._count // self._size * self._size
        for part in (values[:whole].view(-1, self._size), values[None, whole:]):
            if len(part) and part.shape[1] > 1:
                deviation = part.std(1, keepdim=True)
                part.sub_(part.mean(1, keepdim=True)).div_(deviation + 1e-8)
