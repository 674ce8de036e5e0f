# SPDX-License-Identifier: Apache-2.0
"""Trajectories of rockets, built from samples, and their continuation after touchdown."""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import NO_LAYOUT
from rocket_sim_node.telemetry.samples import OWN_FIELDS
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.telemetry.samples import Samples

F64 = NDArray[np.float64]


def up_of(orientation: F64) -> F64:
    """Return the up axes of bodies with attitudes `(n, 4)`, `(n, 3)` in the world."""
    x, y, z, w = orientation.T
    return np.stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)), axis=1)


def tilt_of(orientation: F64) -> F64:
    """Return the tilt from vertical of bodies with attitudes `(n, 4)`, `(n,)` deg."""
    up = up_of(orientation)
    return np.rad2deg(np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2]))


@dataclass(frozen=True)
class Trajectory:
    """One episode of one rocket, from its first state to its last.

    `values` is `(n, layout.width)` as in :class:`Samples`; `outcome` is its name, empty if the end
    was not received; `step` is the simulator's step of the first sample.
    """

    row: int
    episode: int
    step: int
    outcome: str
    values: F64
    layout: Layout = NO_LAYOUT

    def __len__(self) -> int:
        """Return n, the number of samples, one more than the number of steps."""
        return len(self.values)

    def __getattr__(self, name: str) -> F64:
        """Return a quantity by its name, `(n, k)`; `(n,)` for scalars of :data:`FIELDS`."""
        if name not in FIELDS and name not in OWN_FIELDS:
            raise AttributeError(name)
        column = self.values[:, self.layout.place(name)]
        return column[:, 0] if name in FIELDS and column.shape[1] == 1 else column

    @property
    def up(self) -> F64:
        """The direction of the nose in the world, `(n, 3)`."""
        return up_of(self.orientation)

    @property
    def tilt(self) -> F64:
        """Angle between the rocket's axis and the vertical, `(n,)` deg."""
        return tilt_of(self.orientation)

    @property
    def speed(self) -> F64:
        """Magnitude of the velocity, `(n,)` m/s."""
        return np.hypot(np.hypot(*self.linear_velocity[:, :2].T), self.linear_velocity[:, 2])

    @property
    def distance(self) -> F64:
        """Horizontal distance from the pad's centre, `(n,)` m."""
        return np.hypot(self.position[:, 0], self.position[:, 1])

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Whether there is a contact force or a foot in contact, `(n,)`."""
        pushed: NDArray[np.bool_] = np.any(self.contact_force != 0.0, axis=1)
        stands: NDArray[np.bool_] = np.any(self.contact > 0.0, axis=1)
        return pushed | stands

    @property
    def total_return(self) -> float:
        """Undiscounted sum of rewards; the first sample belongs to no step."""
        return float(self.reward[1:].sum())

    def followed_by(self, settling: Settling | None) -> Trajectory:
        """Return it with the samples after its touchdown appended, if there are any."""
        if settling is None:
            return self
        return replace(self, values=np.concatenate((self.values, settling.values)))


@dataclass(frozen=True)
class Settling:
    """Motion of a rocket after the touchdown that ended its flight.

    `verdict` is a word such as 'stands' or 'tips_over'; `values` `(m, k)` are m further samples,
    one per step, in the layout of the flight that they follow.
    """

    verdict: str
    values: F64

    @classmethod
    def build(
        cls, verdict: str, position: NDArray[Any], orientation: NDArray[Any],
        layout: Layout = NO_LAYOUT, **quantities: NDArray[Any],
    ) -> Settling:
        """Create one from known quantities; the rest is 0: no engine, no torque, no reward.

        :param position: `(m, 3)` m and `orientation` `(m, 4)` x y z w, z up.
        :param layout: of the flight.
        :param quantities: others of :data:`FIELDS` and :data:`OWN_FIELDS`, `(m, k)`.
        :raises ValueError: when one has the wrong size, naming it.
        """
        values = np.zeros((len(position), layout.width))
        given = {'position': position, 'orientation': orientation, **quantities}
        for name, numbers in given.items():
            if name not in FIELDS and name not in OWN_FIELDS:
                raise ValueError(f'settling: unknown quantity {name!r}')
            columns = values[:, layout.place(name)]
            if np.size(numbers) != columns.size:
                raise ValueError(
                    f'settling: {name} has {np.size(numbers)} values, expected {columns.size}')
            columns[:] = np.reshape(numbers, columns.shape)
        return cls(verdict, values)


class TrajectoryBuffer:
    """Collects the samples of one rocket in preallocated memory.

    `episode` and `first_step`, in the simulator, are those of the flight; -1 and 0 if there is
    none.
    """

    def __init__(self, capacity: int = 1600) -> None:
        """Allocate memory; it doubles when a flight is longer."""
        self._layout = NO_LAYOUT
        self._values = np.empty((capacity, self._layout.width))
        self.clear()

    def clear(self) -> None:
        """Discard the collected samples."""
        self._count = 0
        self.first_step = 0
        self.episode = -1
        self._last_step = -1

    def __len__(self) -> int:
        """Return the number of samples collected."""
        return self._count

    def extend(self, samples: Samples) -> bool:
        """Add samples of one episode in the order of their steps.

        :return: false, with nothing kept, if they neither continue the collected samples nor begin
            an episode: part of its start was missed.
        """
        begins = samples.values[0, FIELDS['time'].start] == 0.0
        gapless = samples.step[-1] - samples.step[0] == len(samples.step) - 1
        follows = (
            self._count > 0 and samples.layout == self._layout
            and samples.episode[0] == self.episode
            and samples.step[0] == self._last_step + 1)
        if not gapless or not (begins or follows):
            self.clear()
            return False
        if begins:
            self.clear()
            if samples.layout != self._layout:
                self._layout = samples.layout
                self._values = np.empty((len(self._values), self._layout.width))
            self.first_step = int(samples.step[0])
            self.episode = int(samples.episode[0])
        end = self._count + len(samples.step)
        while end > len(self._values):
            self._values = np.concatenate((self._values, np.empty_like(self._values)))
        self._values[self._count:end] = samples.values
        self._count = end
        self._last_step = int(samples.step[-1])
        return True

    def so_far(self, row: int, outcome: str = '') -> Trajectory:
        """Return a copy of the flight collected so far."""
        return Trajectory(
            row, self.episode, self.first_step, outcome, self._values[:self._count].copy(),
            self._layout)

    def finish(self, row: int, outcome: str) -> Trajectory:
        """Return the collected flight, and start a new one."""
        flight = self.so_far(row, outcome)
        self.clear()
        return flight
