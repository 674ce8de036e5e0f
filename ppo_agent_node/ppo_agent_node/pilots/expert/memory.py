# SPDX-License-Identifier: Apache-2.0
"""A pilot's memory of a flight: that the engine is lit, and the fuel it has burnt.

A row is forgotten when an episode begins in it, which whoever flies it says. Where nothing is
said of episodes, a height that does not go on from one call to the next tells of one, though not
of each: after a rocket that failed within a second of its spawn the next one begins as high.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.expert.observed_state import ObservedState
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

_JUMP = 10.0
"""m of height beyond the fall of a step that no flight shows, nor noise of the usual size"""


class FlightMemory:
    """Remembers the flights of N rockets, row by row."""

    def __init__(self, vehicle: RocketSettings) -> None:
        """Begin with nothing remembered."""
        self._vehicle = vehicle
        self._start = vehicle.spawn_height - vehicle.touchdown_height
        self._flow = vehicle.max_thrust / (vehicle.specific_impulse * vehicle.gravity)
        self._height = np.zeros(0)
        self._told = False
        self._begun: Bools | None = np.zeros(0, np.bool_)
        """`(N,)` rows in which an episode begins with the next look; None: all"""
        self.burnt = np.zeros(0)
        """`(N,)` kg since the spawn, of an engine that does as it is told; NaN: not known"""
        self.lit = np.zeros(0, np.bool_)
        """`(N,)` whether the engine was seen or told to burn"""

    def begin(self, rows: NDArray[np.int64] | None = None) -> None:
        """Take note that the next look shows the first moment of an episode.

        Once this was told, heights are no longer asked whether a flight goes on.

        :param rows: `(K,)` in which; None: in all.
        """
        self._told = True
        if rows is None:
            self._begun = None
        elif self._begun is not None:
            self._begun[rows] = True

    def look(self, state: ObservedState) -> Bools:
        """Take note of where the rockets are; return which flights were not known, `(N,)`."""
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
        """Take note of the throttle `(N,)` that is flown until the next call."""
        on = throttle > self._vehicle.throttle_cutoff
        self.lit = self.lit | on
        self.burnt = self.burnt + self._flow * self._vehicle.dt * np.where(on, throttle, 0.0)
