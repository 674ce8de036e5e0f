# SPDX-License-Identifier: Apache-2.0
"""Memory of a pilot for each flight: whether the engine is lit, and the burned fuel.

A row is reset when an episode begins in it, of which the caller notifies the pilot. Without
notifications, a discontinuity of the height reveals a new episode, but not always: after a rocket
that failed within a second of its spawn the next one begins at the same height.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.expert.observed_state import ObservedState
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

_JUMP = 10.0
"""m, height change beyond a step's fall that neither flight nor usual noise can cause."""


class FlightMemory:
    """Memory of the flights of N rockets, row by row."""

    def __init__(self, vehicle: RocketSettings) -> None:
        """Start empty."""
        self._vehicle = vehicle
        self._start = vehicle.spawn_height - vehicle.touchdown_height
        self._flow = vehicle.max_thrust / (vehicle.specific_impulse * vehicle.gravity)
        self._height = np.zeros(0)
        self._told = False
        self._begun: Bools | None = np.zeros(0, np.bool_)
        """`(N,)` rows in which an episode begins with the next observation; None: all."""
        self.burnt = np.zeros(0)
        """`(N,)` kg since the spawn, if the engine follows commands; NaN: unknown."""
        self.lit = np.zeros(0, np.bool_)
        """`(N,)` whether the engine was observed or commanded to burn."""

    def begin(self, rows: NDArray[np.int64] | None = None) -> None:
        """Note that the next observation is the first of an episode.

        After the first call, discontinuities of the height are no longer evaluated.

        :param rows: `(K,)` rows; None: all.
        """
        self._told = True
        if rows is None:
            self._begun = None
        elif self._begun is not None:
            self._begun[rows] = True

    def look(self, state: ObservedState) -> Bools:
        """Record the rockets' heights; return which flights are new, `(N,)`."""
        count = len(state.origin_height)
        if len(self._height) != count:
            self._height = np.full(count, np.inf)
            self.burnt, self.lit = np.zeros(count), np.zeros(count, np.bool_)
            self._begun = None if self._begun is None else np.zeros(count, np.bool_)
        begun = np.ones(count, np.bool_) if self._begun is None else self._begun
        expected = self._height - state.speed * self._vehicle.dt
        fresh = begun | ~np.isfinite(expected)
        if not self._told:
            fresh |= np.abs(state.origin_height - expected) > _JUMP
        spawned = begun | (np.abs(state.origin_height - self._start) < _JUMP)
        self.burnt = np.where(fresh, np.where(spawned, 0.0, np.nan), self.burnt)
        self.lit = np.where(fresh, False, self.lit)
        self._height, self._begun = state.origin_height.copy(), np.zeros(count, np.bool_)
        return fresh

    def command(self, throttle: F64) -> None:
        """Record the throttle `(N,)` that is applied until the next call."""
        on = throttle > self._vehicle.throttle_cutoff
        self.lit = self.lit | on
        self.burnt = self.burnt + self._flow * self._vehicle.dt * np.where(on, throttle, 0.0)
