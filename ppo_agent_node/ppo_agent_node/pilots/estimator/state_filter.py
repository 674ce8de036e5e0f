# SPDX-License-Identifier: Apache-2.0
"""The state of rockets out of noisy sights, and what that says of engine and side acceleration.

With noisy speeds an acceleration is known from how far speeds and heights have come, not from the
steps between them; so strength of the engine and side acceleration are states of the filters.
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
"""after which the noise is known well enough to filter"""


@dataclass(frozen=True)
class Expected:
    """Prior knowledge of the forces on rockets."""

    gravity: float
    """m/s^2"""
    strength: float
    """factor of the engine's acceleration, and how far vehicles differ"""
    strength_spread: float
    side_spread: float
    """m/s^2, standard deviation of the side acceleration along an axis"""
    side_wandering: float
    """m/s^2 by which it changes in a second"""
    disturbance: float
    """m/s^2, standard deviation of what else there is"""


class StateFilter:
    """Filters the sights of N rockets, row by row; passes on those without noise."""

    def __init__(self, count: int, dt: float, expected: Expected) -> None:
        """Begin with nothing seen."""
        self._expected = expected
        self._body = AxisOfBody(count, dt)
        self._vertical = AxisFilter(
            1, count, dt, expected.strength, expected.strength_spread)
        self._lateral = AxisFilter(2, count, dt, 0.0, expected.side_spread)
        self._last: ObservedState | None = None

    @property
    def noise(self) -> F64:
        """`(N,)` the noise of the sensors; 0: none."""
        return self._body.noise

    @property
    def strength(self) -> F64:
        """`(N,)` factor of the engine's acceleration, where there is noise."""
        strength: F64 = self._vertical.factor[0]
        return strength

    @property
    def side(self) -> F64:
        """`(2, N)` m/s^2, the side acceleration, where there is noise."""
        return self._lateral.factor

    @property
    def deviation(self) -> tuple[F64, F64]:
        """Standard deviations `(N,)` of height and speed downwards, m and m/s; 0: no noise."""
        variance = np.where(self.noise > 0, self._vertical.covariance[[0, 1], [0, 1]], 0.0)
        height, speed = np.sqrt(variance)
        return height, speed

    def update(self, state: ObservedState, fresh: Bools, push: F64, damping: F64) -> ObservedState:
        """Return the state after a step.

        :param fresh: `(N,)` rows whose flight was not known.
        :param push: `(N,)` m/s^2, acceleration that the engine was to give in the step.
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
