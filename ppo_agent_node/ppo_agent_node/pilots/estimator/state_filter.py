# SPDX-License-Identifier: Apache-2.0
"""Filter for the state of rockets with noisy sensors, engine strength and side acceleration.

With noisy speeds, accelerations can only be inferred from the accumulated speeds and heights, not
from single steps; so strength of the engine and side acceleration are states of the filters.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppo_agent_node.pilots.estimator.kalman import AxisFilter
from ppo_agent_node.pilots.estimator.kalman import AxisOfBody
from ppo_agent_node.pilots.expert.observed_state import ObservedState
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools

_STEPS = 5
"""Number of observations after which the noise estimate is used."""


@dataclass(frozen=True)
class Expected:
    """Prior knowledge of the forces on rockets."""

    gravity: float
    """m/s^2."""
    strength: float
    """Factor of the engine's acceleration, and its standard deviation among vehicles."""
    strength_spread: float
    side_spread: float
    """m/s^2, standard deviation of the side acceleration along an axis."""
    side_wandering: float
    """m/s^2 by which it changes in a second."""
    disturbance: float
    """m/s^2, standard deviation of other accelerations."""


class StateFilter:
    """Filters the observations of N rockets, row by row; without noise they pass unchanged."""

    def __init__(self, count: int, dt: float, expected: Expected) -> None:
        """Initialise without observations."""
        self._expected = expected
        self._body = AxisOfBody(count, dt)
        self._vertical = AxisFilter(
            1, count, dt, expected.strength, expected.strength_spread)
        self._lateral = AxisFilter(2, count, dt, 0.0, expected.side_spread)
        self._last: ObservedState | None = None

    @property
    def noise(self) -> F64:
        """`(N,)` noise of the sensors; 0: none."""
        return self._body.noise

    @property
    def strength(self) -> F64:
        """`(N,)` factor of the engine's acceleration, for rows with noise."""
        strength: F64 = self._vertical.factor[0]
        return strength

    @property
    def side(self) -> F64:
        """`(2, N)` m/s^2, the side acceleration, for rows with noise."""
        return self._lateral.factor

    @property
    def deviation(self) -> tuple[F64, F64]:
        """Standard deviations `(N,)` of height and downward speed, m and m/s; 0: no noise."""
        variance = np.where(self.noise > 0, self._vertical.covariance[[0, 1], [0, 1]], 0.0)
        height, speed = np.sqrt(variance)
        return height, speed

    def update(self, state: ObservedState, fresh: Bools, push: F64, damping: F64) -> ObservedState:
        """Return the state after a step.

        :param fresh: `(N,)` rows in which a new flight begins.
        :param push: `(N,)` m/s^2, acceleration expected from the engine in the step.
        :param damping: `(N,)` 1/s, deceleration by drag for each m/s.
        """
        known, last = self._expected, state if self._last is None else self._last
        self._body.update(state, fresh)
        noise = self.noise
        height, speed = state.origin_height[None], state.velocity[1:2]
        self._vertical.predict(
            -(known.gravity + damping * last.velocity[1])[None], push * last.up[1],
            known.disturbance, 0.0)
        self._lateral.predict(
            push * self.strength * last.up[::2] - damping * last.drift, np.ones_like(push),
            known.disturbance, known.side_wandering)
        self._vertical.correct(height, speed, noise)
        self._lateral.correct(state.lateral, state.drift, noise)
        begin = fresh | (noise == 0) | (self._body.seen < _STEPS)
        self._vertical.begin(begin, height, speed, noise)
        self._lateral.begin(begin, state.lateral, state.drift, noise)
        x, z = self._lateral.velocity
        origin = self._vertical.position[0]
        self._last = ObservedState(
            state.height + origin - state.origin_height, origin, self._lateral.position,
            np.stack((x, self._vertical.velocity[0], z)),
            np.where(noise > 0, self._body.up, state.up), state.spin)
        return self._last
