# SPDX-License-Identifier: Apache-2.0
"""Samples in the order of an epoch, cut into minibatches and these into pieces."""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


class Minibatch(NamedTuple):
    """Samples that one step is made from."""

    start: int
    stop: int
    """the first, and the first that is no more in it, in the order of the epoch"""
    pieces: list[tuple[Tensor, ...]]
    """views of fields and results, `rows` samples at most"""


class Minibatches:
    """The memory of an epoch and the views of it, made once an update.

    Samples are gathered for a whole epoch at once, so that a minibatch is a piece of memory
    that is read from one end to the other, and costs no gathering of its own.
    """

    def __init__(
        self, fields: Sequence[Tensor], results: Sequence[Tensor], size: int, rows: int,
    ) -> None:
        """Allocate.

        :param fields: `(S, ...)`, what is known of each sample, in the order of the roll-out.
        :param results: `(S, ...)`, what is found out in an epoch, in the epoch's order.
        :param size: samples of a minibatch; the last one may be smaller.
        :param rows: samples of a piece at most.
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
        """Go through the minibatches in order."""
        return iter(self._minibatches)

    def shuffle(self, order: Tensor) -> tuple[Tensor, ...]:
        """Put the fields into an order `(S,)`; return them so."""
        for field, shuffled in zip(self._fields, self._shuffled, strict=True):
            torch.index_select(field, 0, order, out=shuffled)
        return self._shuffled

    def normalise_(self, values: Tensor) -> None:
        """Give the values `(S,)` of each minibatch mean 0 and standard deviation 1, in place.

        A minibatch of one sample stays as it is.
        """
        whole = self._count // self._size * self._size
        for part in (values[:whole].view(-1, self._size), values[None, whole:]):
            if len(part) and part.shape[1] > 1:
                deviation = part.std(1, keepdim=True)
                part.sub_(part.mean(1, keepdim=True)).div_(deviation + 1e-8)
