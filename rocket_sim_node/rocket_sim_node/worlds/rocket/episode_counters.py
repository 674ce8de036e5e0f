# SPDX-License-Identifier: Apache-2.0
"""Counters for the report of an episode: control effort, hovering."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket.actuators import IDLE

HOVER_SPEED = 2.0
"""m/s: slower than this, a burning engine hovers, be it a hand's breadth above touchdown height"""


class EpisodeCounters:
    """N rockets: `effort` `(N, 3)` sums by axis of the command; `hover` `(N,)` steps.

    `commanded` `(N,)` is the last throttle asked for, -1 to 1.
    """

    def __init__(self, num_envs: int) -> None:
        """Begin with nothing."""
        self.effort = np.zeros((num_envs, 3))
        self.hover = np.zeros(num_envs, np.int64)
        self._before = np.zeros((num_envs, 3))
        self.commanded = self._before[:, 0]
        self.begin(np.arange(num_envs))

    def begin(self, rows: NDArray[np.integer]) -> None:
        """Forget the episodes that rockets were in."""
        self.effort[rows] = 0.0
        self.hover[rows] = 0
        self.commanded[rows] = IDLE[0]

    def note_command(self, command: F64) -> None:
        """Count how much is asked for: change of the throttle, size of the torques."""
        change = command - self._before
        np.abs(change, out=change)
        self.effort += change
        self.commanded[:] = command[:, 0]

    def note_flight(self, speed: F64, height: F64, throttle: F64, ground: float) -> None:
        """Count who hovers: m/s, m, and 0 to 1, `(N,)` each; touchdown is at `ground` m."""
        slow = speed < HOVER_SPEED
        if slow.any():
            slow &= height > ground
            slow &= throttle > 0.0
            self.hover += slow

    def hover_time(self, rows: NDArray[np.integer], dt: float) -> F64:
        """Return how long rockets hovered, `(K,)` s."""
        time: F64 = self.hover[rows].astype(np.float64) * dt
        return time

    def mean_effort(self, rows: NDArray[np.integer], length: NDArray[np.integer]) -> F64:
        """Return the control effort `(K,)` of a step, of episodes that took `length` steps."""
        effort = self.effort[rows]
        total: F64 = (0.5 * effort[:, 0] + effort[:, 1] + effort[:, 2]) / length
        return total
