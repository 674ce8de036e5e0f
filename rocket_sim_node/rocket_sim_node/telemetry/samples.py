# SPDX-License-Identifier: Apache-2.0
"""Samples of rockets' states, as received from a simulator."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

FLYING = 255
"""Outcome of a sample whose episode has not ended."""

FIELDS = {
    'time': slice(0, 1), 'position': slice(1, 4), 'orientation': slice(4, 8),
    'linear_velocity': slice(8, 11), 'angular_velocity': slice(11, 14), 'torque': slice(14, 17),
    'mass': slice(17, 18), 'fuel': slice(18, 19), 'throttle': slice(19, 20),
    'thrust': slice(20, 21), 'reward': slice(21, 22), 'lateral_thrust': slice(22, 23),
    'contact_force': slice(23, 26), 'commanded_throttle': slice(26, 27),
    'disturbance': slice(27, 30),
}
"""Columns of the quantities that every world has."""

WIDTH = 30
"""Number of columns of a world without legs, terrain and conditions."""

_MOST_EACH = 1024
"""Maximum number of legs, terrain heights or conditions; a trajectory stores them for each
step."""

OWN_FIELDS = ('contact', 'leg_angle', 'terrain', 'conditions')
"""Quantities after those of :data:`FIELDS`; their widths depend on the world."""


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
        return WIDTH + 2 * self.legs + self.heights + self.conditions

    def place(self, name: str) -> slice:
        """Return the columns of a quantity of :data:`FIELDS` or :data:`OWN_FIELDS`."""
        if name in FIELDS:
            return FIELDS[name]
        widths = self.legs, self.legs, self.heights, self.conditions
        index = OWN_FIELDS.index(name)
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
    """S samples, each of one rocket at one step; RocketState.msg defines the quantities.

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
