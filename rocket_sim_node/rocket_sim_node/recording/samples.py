# SPDX-License-Identifier: Apache-2.0
"""States of rockets as they come from a simulator, and the flights they add up to."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

FLYING = 255
"""The outcome of a sample whose flight still goes on."""

FIELDS = {
    'time': slice(0, 1), 'position': slice(1, 4), 'orientation': slice(4, 8),
    'linear_velocity': slice(8, 11), 'angular_velocity': slice(11, 14), 'torque': slice(14, 17),
    'mass': slice(17, 18), 'fuel': slice(18, 19), 'throttle': slice(19, 20),
    'thrust': slice(20, 21), 'reward': slice(21, 22),
}
"""Where the quantities of a sample lie in a row of 22 numbers."""

WIDTH = 22


@dataclass(frozen=True)
class Samples:
    """S samples, each of one rocket at one step; see RocketState.msg for the meaning.

    World frame with z up (REP 103), SI units. `step`, `row`, `episode`, `outcome` are `(S,)`
    whole numbers, `values` is `(S, 22)` with the columns of :data:`FIELDS`.
    """

    step: I64
    row: I64
    episode: I64
    outcome: I64
    values: F64

    @classmethod
    def build(
        cls, step: NDArray[Any], row: NDArray[Any], episode: NDArray[Any],
        outcome: NDArray[Any], **quantities: NDArray[Any],
    ) -> Samples:
        """Make samples from one array per quantity.

        :param quantities: every name of :data:`FIELDS`, `(S, k)` or flattened row-major.
        :raises ValueError: when one is missing or of another length, naming it.
        """
        count = len(step)
        values = np.empty((count, WIDTH))
        for name, place in FIELDS.items():
            width = place.stop - place.start
            if name not in quantities or np.size(quantities[name]) != count * width:
                raise ValueError(
                    f'{name}: {np.size(quantities.get(name, ()))} values, '
                    f'expected {count * width} ({count} samples x {width})')
            values[:, place] = np.reshape(quantities[name], (count, width))
        whole = []
        for name, numbers in (('step', step), ('row', row), ('episode', episode),
                              ('outcome', outcome)):
            if np.size(numbers) != count:
                raise ValueError(f'{name}: {np.size(numbers)} values, expected {count}')
            whole.append(np.asarray(numbers).astype(np.int64))
        return cls(whole[0], whole[1], whole[2], whole[3], values)

    def take(self, index: NDArray[Any] | slice) -> Samples:
        """Return the chosen samples."""
        return Samples(
            self.step[index], self.row[index], self.episode[index], self.outcome[index],
            self.values[index])


@dataclass(frozen=True)
class Flight:
    """One episode of one rocket, from its first state to its last.

    `values` is `(n, 22)` as in :class:`Samples`; `outcome` is its name, empty when the flight
    was not seen to its end; `step` is the simulator's step of the first sample.
    """

    row: int
    episode: int
    step: int
    outcome: str
    values: F64

    def __len__(self) -> int:
        """Return n, the number of samples, one more than the steps flown."""
        return len(self.values)

    def __getattr__(self, name: str) -> F64:
        """Return a quantity by its name in :data:`FIELDS`, `(n, k)`, or `(n,)` for scalars."""
        if name not in FIELDS:
            raise AttributeError(name)
        column = self.values[:, FIELDS[name]]
        return column[:, 0] if column.shape[1] == 1 else column

    @property
    def up(self) -> F64:
        """The direction of the nose in the world, `(n, 3)`."""
        x, y, z, w = self.orientation.T
        return np.stack(
            (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)), axis=1)

    @property
    def tilt(self) -> F64:
        """Angle between the rocket's axis and the vertical, `(n,)` deg."""
        up = self.up
        return np.rad2deg(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2]))

    @property
    def speed(self) -> F64:
        """Magnitude of the velocity, `(n,)` m/s."""
        return np.hypot(np.hypot(*self.linear_velocity[:, :2].T), self.linear_velocity[:, 2])

    @property
    def distance(self) -> F64:
        """Horizontal distance from the pad's centre, `(n,)` m."""
        return np.hypot(self.position[:, 0], self.position[:, 1])

    @property
    def total_return(self) -> float:
        """Undiscounted sum of rewards; the first sample belongs to no step."""
        return float(self.reward[1:].sum())


class FlightBuffer:
    """Collects the samples of one rocket in memory set aside beforehand."""

    def __init__(self, capacity: int = 1600) -> None:
        """Set memory aside; it doubles when a flight is longer."""
        self._values = np.empty((capacity, WIDTH))
        self.clear()

    def clear(self) -> None:
        """Forget what was collected."""
        self._count = 0
        self._first_step = 0
        self._last_step = -1
        self._episode = -1

    def __len__(self) -> int:
        """Return the number of samples collected."""
        return self._count

    def extend(self, samples: Samples) -> bool:
        """Add samples of one episode in the order of their steps.

        :return: false, with nothing kept, when they do not continue what is here and do not
            begin an episode: the start, or a part of it, was missed.
        """
        begins = samples.values[0, 0] == 0.0
        gapless = samples.step[-1] - samples.step[0] == len(samples.step) - 1
        follows = (
            self._count > 0 and samples.episode[0] == self._episode
            and samples.step[0] == self._last_step + 1)
        if not gapless or not (begins or follows):
            self.clear()
            return False
        if begins:
            self.clear()
            self._first_step = int(samples.step[0])
            self._episode = int(samples.episode[0])
        end = self._count + len(samples.step)
        while end > len(self._values):
            self._values = np.concatenate((self._values, np.empty_like(self._values)))
        self._values[self._count:end] = samples.values
        self._count = end
        self._last_step = int(samples.step[-1])
        return True

    def finish(self, row: int, outcome: str) -> Flight:
        """Return the flight collected, as a copy, and begin anew."""
        flight = Flight(
            row, self._episode, self._first_step, outcome, self._values[:self._count].copy())
        self.clear()
        return flight
