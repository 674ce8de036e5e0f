# SPDX-License-Identifier: Apache-2.0
"""Actuators: command delay, ignition, minimum throttle and engine lag."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket.drawn_vehicle import DrawnVehicles
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

IDLE = (-1.0, 0.0, 0.0)
"""Engine off, no torque."""


class CommandLine:
    """The last commands of N rockets, newest first: `commands` `(L, N, 3)`, idle before the first.

    L is the number of commands needed by the command delay or the observation, possibly 0.
    """

    def __init__(self, num_envs: int, length: int) -> None:
        """Start without commands."""
        self.commands = np.empty((length, num_envs, 3))
        self.commands[:] = IDLE
        self._rows = np.arange(num_envs)

    def begin(self, rows: NDArray[np.integer]) -> None:
        """Clear the commands of rockets."""
        if len(self.commands):
            self.commands[:, rows] = IDLE

    def push(self, command: F64, vehicles: DrawnVehicles) -> F64:
        """Store the commands `(N, 3)` of a step; return those that take effect in it."""
        if not len(self.commands):
            return command
        self.commands[1:] = self.commands[:-1]
        self.commands[0] = command
        return self.commands[vehicles.delay, self._rows] if vehicles.delayed else command


class Engines:
    """N engines: `throttle` `(N,)` 0 to 1, `lit` `(N,)`, `ignitions` `(N,)` since the start."""

    def __init__(self, num_envs: int) -> None:
        """Start with all engines off."""
        self.throttle = np.zeros(num_envs)
        self.lit = np.zeros(num_envs, np.bool_)
        self.ignitions = np.zeros(num_envs, np.int64)

    def begin(self, rows: NDArray[np.integer]) -> None:
        """Set the engines of rockets to their initial state."""
        self.throttle[rows] = 0.0
        self.lit[rows] = False
        self.ignitions[rows] = 0

    def follow(self, asked: F64, fuel: F64, vehicles: DrawnVehicles, s: RocketSettings) -> F64:
        """Advance by a step; return the throttle `(N,)` during it.

        An engine burns while a throttle is commanded, at its minimum throttle or above, and must
        be lit again afterwards. It follows the command exactly as a first-order system does.

        :param asked: `(N,)` commanded throttle, 0 to 1; is modified.
        :param fuel: `(N,)` kg.
        """
        fuelled = fuel > 0.0
        lit = asked > s.throttle_cutoff
        lit &= fuelled
        if s.ignitions:
            lit &= self.lit | (self.ignitions < s.ignitions)
        asked *= lit
        self.ignitions += lit > self.lit
        self.lit = lit
        if vehicles.floored:
            np.maximum(asked, vehicles.floor, out=asked, where=lit)
        if vehicles.lagged:
            asked += (self.throttle - asked) * vehicles.lag_kept
            asked *= fuelled
        self.throttle = asked
        return asked
