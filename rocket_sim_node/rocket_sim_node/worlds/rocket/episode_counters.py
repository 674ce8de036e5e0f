# SPDX-License-Identifier: Apache-2.0
"""Per-episode counters of control effort and hovering."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket.actuators import IDLE

HOVER_SPEED = 2.0
"""m/s: below this speed a burning engine hovers, even just above touchdown height."""


class EpisodeCounters:
    """Counters of N rockets: `effort` `(N, 3)` sums by axis of the command; `hover` `(N,)` steps.

    `commanded` `(N,)` is the last commanded throttle, -1 to 1.
    """

    def __init__(self, num_envs: int) -> None:
        """Initialise the counters to 0."""
        self.effort = np.zeros((num_envs, 3))
        self.hover = np.zeros(num_envs, np.int64)
        self._before = np.zeros((num_envs, 3))
        self.commanded = self._before[:, 0]
        self.begin(np.arange(num_envs))

    def begin(self, rows: NDArray[np.integer]) -> None:
        """Reset the counters of rockets."""
        self.effort[rows] = 0.0
        self.hover[rows] = 0
        self.commanded[rows] = IDLE[0]

    def note_command(self, command: F64) -> None:
        """Add the control effort of a command: change of the throttle, size of the torques."""
        change = command - self._before
        np.abs(change, out=change)
        self.effort += change
        self.commanded[:] = command[:, 0]

    def note_flight(
        self, speed: F64, height: F64, throttle: F64, lit: NDArray[np.bool_], ground: float,
    ) -> None:
        """Count hovering rockets: m/s, m, 0 to 1 and whether the engine is on, `(N,)` each.

        :param lit: after a cut-off, the throttle of an engine with a lag fades, but is never 0.
        :param ground: height of touchdown, m.
        """
        slow = speed < HOVER_SPEED
        if slow.any():
            slow &= height > ground
            slow &= throttle > 0.0
            slow &= lit
            self.hover += slow

    def hover_time(self, rows: NDArray[np.integer], dt: float) -> F64:
        """Return the rockets' hover times, `(K,)` s."""
        time: F64 = self.hover[rows].astype(np.float64) * dt
        return time

    def mean_effort(self, rows: NDArray[np.integer], length: NDArray[np.integer]) -> F64:
        """Return the mean control effort `(K,)` per step, of episodes that took `length` steps."""
        effort = self.effort[rows]
        total: F64 = (0.5 * effort[:, 0] + effort[:, 1] + effort[:, 2]) / length
        return total
