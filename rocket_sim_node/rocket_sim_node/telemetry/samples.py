# SPDX-License-Identifier: Apache-2.0
"""Samples of rockets' states, as received from a simulator."""
from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.quantities import QUANTITIES

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

LABELS = ('row', 'episode', 'outcome')
"""Quantities that samples hold as integers, beside their values."""
_WIDTHS = {
    quantity.name: quantity.width for quantity in QUANTITIES
    if quantity.name not in LABELS and isinstance(quantity.width, int)}
_ENDS = accumulate(_WIDTHS.values())
FIELDS = {
    name: slice(end - _WIDTHS[name], end) for name, end in zip(_WIDTHS, _ENDS, strict=True)}
"""Columns of the quantities that are equally wide in every world."""
OWN_FIELDS = {
    quantity.name: str(quantity.width) for quantity in QUANTITIES
    if not isinstance(quantity.width, int)}
"""Quantities after those of :data:`FIELDS`, with the letters of their widths."""
WIDTH = sum(_WIDTHS.values())
"""Number of columns of a world without legs, terrain and conditions."""

_BEYOND_ALL = 1e30
"""Limit that no valid quantity reaches; recordings hold single precision."""
_MOST_EACH = 1024
"""Maximum number of legs, terrain heights or conditions; a trajectory stores them for each
step."""


@dataclass(frozen=True)
class Layout:
    """Columns of a world's quantities in a row of values.

    The world has L legs, H terrain heights and C conditions that are drawn for each episode.
    """

    legs: int = 0
    heights: int = 0
    conditions: int = 0

    @property
    def width(self) -> int:
        """Number of columns."""
        return WIDTH + sum(self._widths)

    @property
    def _widths(self) -> list[int]:
        letters = {'L': self.legs, 'H': self.heights, 'C': self.conditions}
        return [letters[letter] for letter in OWN_FIELDS.values()]

    def place(self, name: str) -> slice:
        """Return the columns of a quantity of :data:`FIELDS` or :data:`OWN_FIELDS`."""
        if name in FIELDS:
            return FIELDS[name]
        widths, index = self._widths, list(OWN_FIELDS).index(name)
        first = WIDTH + sum(widths[:index])
        return slice(first, first + widths[index])


NO_LAYOUT = Layout()
"""Layout of a world with none of them."""


def _per_sample(name: str, values: NDArray[Any], count: int) -> int:
    """Return how many numbers a quantity has per sample."""
    if np.size(values) and (not count or np.size(values) % count):
        raise ValueError(
            f'{name}: {np.size(values)} values, expected a multiple of {count}, the samples')
    each = np.size(values) // count if count else 0
    if each > _MOST_EACH:
        raise ValueError(f'{name}: {each} values a sample, expected {_MOST_EACH} at most')
    return each


@dataclass(frozen=True)
class Samples:
    """S samples, each of one rocket at one step; `quantities` defines what they hold.

    World frame with z up (REP 103), SI units. `step`, `row`, `episode`, `outcome` are integer
    arrays `(S,)`, `values` is `(S, layout.width)`.
    """

    step: I64
    row: I64
    episode: I64
    outcome: I64
    values: F64
    layout: Layout = NO_LAYOUT

    @classmethod
    def build(
        cls, step: NDArray[Any], row: NDArray[Any], episode: NDArray[Any],
        outcome: NDArray[Any], **quantities: NDArray[Any],
    ) -> Samples:
        """Create samples from one array per quantity.

        :param quantities: all names of :data:`FIELDS`, `(S, k)` or flattened row-major, and
            those of :data:`OWN_FIELDS` that the world has.
        :raises ValueError: when one is missing or has the wrong length, naming it.
        """
        count = len(step)
        none = np.empty(0)
        layout = Layout(*(
            _per_sample(name, quantities.get(name, none), count)
            for name in ('contact', 'terrain', 'conditions')))
        values = np.empty((count, layout.width))
        for name in (*FIELDS, *OWN_FIELDS):
            place = layout.place(name)
            width = place.stop - place.start
            given = quantities.get(name, none)
            if np.size(given) != count * width:
                raise ValueError(
                    f'{name}: {np.size(given)} values, '
                    f'expected {count * width} ({count} samples x {width})')
            values[:, place] = np.reshape(given, (count, width))
        whole = []
        for name, numbers in (('step', step), ('row', row), ('episode', episode),
                              ('outcome', outcome)):
            if np.size(numbers) != count:
                raise ValueError(f'{name}: {np.size(numbers)} values, expected {count}')
            whole.append(np.asarray(numbers).astype(np.int64))
        return cls(whole[0], whole[1], whole[2], whole[3], values, layout)

    def take(self, index: NDArray[Any] | slice) -> Samples:
        """Return the selected samples."""
        return Samples(
            self.step[index], self.row[index], self.episode[index], self.outcome[index],
            self.values[index], self.layout)


def samples_of(message: Any) -> Samples:
    """Return the samples in a message of type RocketState.

    :param message: as received, or as read from a bag: any object with its fields.
    :raises ValueError: when a field has the wrong length or a non-finite value, naming it.
    """
    samples = Samples.build(np.asarray(message.step), **{
        quantity.name: np.asarray(getattr(message, quantity.name)) for quantity in QUANTITIES})
    good = np.abs(samples.values) < _BEYOND_ALL
    if not good.all():
        name = next(name for name in (*FIELDS, *OWN_FIELDS)
                    if not good[:, samples.layout.place(name)].all())
        raise ValueError(f'{name}: a value is not finite, or beyond {_BEYOND_ALL:g}')
    return samples
