# SPDX-License-Identifier: Apache-2.0
"""A pilot's memory of a flight: that the engine is lit, and the fuel it has burnt.

A memory is kept for as long as a rocket's height goes on from one call to the next. Where it
does not, because an episode began or other rockets are asked about, the row is forgotten.
"""
from __future__ import annotations

import numpy as np

from ppo_agent_node.pilots.sight import Sight
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.vehicle import RocketSettings

_JUMP = 10.0
"""m of height beyond the fall of a step that no flight shows, and no noise of the sensors"""


class FlightMemory:
    """Remembers the flights of N rockets, row by row."""

    def __init__(self, vehicle: RocketSettings) -> None:
        """Begin with nothing remembered."""
        self._vehicle = vehicle
        self._start = vehicle.spawn_height - vehicle.touchdown_height
        self._flow = vehicle.max_thrust / (vehicle.specific_impulse * vehicle.gravity)
        self._height = np.zeros(0)
        self.burnt = np.zeros(0)
        """`(N,)` kg since the spawn, of an engine that does as it is told; NaN: not known"""
        self.lit = np.zeros(0, np.bool_)
        """`(N,)` whether the engine was seen or told to burn"""
        self.known = np.zeros(0, np.bool_)
        """`(N,)` whether the last call was about the same flight"""

    def look(self, sight: Sight) -> Bools:
        """Take note of where the rockets are; return which flights were not known, `(N,)`."""
        count = len(sight.origin_height)
        if len(self._height) != count:
            self._height = np.full(count, np.inf)
            self.burnt, self.lit = np.zeros(count), np.zeros(count, np.bool_)
        expected = self._height - sight.speed * self._vehicle.dt
        fresh = np.abs(sight.origin_height - expected) > _JUMP
        fresh |= ~np.isfinite(expected)
        spawned = np.abs(sight.origin_height - self._start) < _JUMP
        self.burnt = np.where(fresh, np.where(spawned, 0.0, np.nan), self.burnt)
        self.lit = np.where(fresh, False, self.lit)
        self._height, self.known = sight.origin_height.copy(), ~fresh
        return fresh

    def command(self, throttle: F64) -> None:
        """Take note of the throttle `(N,)` that is flown until the next call."""
        on = throttle > self._vehicle.throttle_cutoff
        self.lit = self.lit | on
        self.burnt = self.burnt + self._flow * self._vehicle.dt * np.where(on, throttle, 0.0)
