# SPDX-License-Identifier: Apache-2.0
"""Kalman filters of noisy observations, which also estimate noise and disturbance.

Position, velocity and up vector are noisy, but the spin is not: an axis turned by the observed
spin, compared with the next observed axis, reveals the noise. Without noise, observations pass
unchanged. (Kalman, 'A new approach to linear filtering and prediction problems', 1960.)
"""
from __future__ import annotations

import numpy as np

from ppo_agent_node.pilots.expert.observed_state import ObservedState
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools

POSITION, VELOCITY, ANGLE = 0.5, 0.2, np.deg2rad(1.0)
"""m, m/s and rad: standard deviations for a sensor noise of 1."""
_NONE = 0.02
"""Noise below which it is treated as zero."""


_TINY = 1e-30


def turn(axis: F64, spin: F64, dt: float) -> F64:
    """Return an axis `(3, N)` rotated for a step with `spin` `(3, N)` rad/s (Rodrigues)."""
    rate = np.maximum(np.sqrt((spin**2).sum(axis=0)), 1e-12)
    about, angle = spin / rate, rate * dt
    (a, b, c), (x, y, z) = about, axis
    across = np.stack((b * z - c * y, c * x - a * z, a * y - b * x))  # np.cross takes much longer
    turned: F64 = (
        axis * np.cos(angle) + across * np.sin(angle)
        + about * (about * axis).sum(axis=0) * (1 - np.cos(angle)))
    return turned


class AxisFilter:
    """Filters position, velocity and a factor of a known acceleration, `(A, N)` each.

    x'' = f + b u, with known f and u and unknown b; A equivalent axes share `covariance`
    `(3, 3, N)`, of x, v and b.
    """

    def __init__(self, axes: int, count: int, dt: float, factor: float, spread: float) -> None:
        """Initialise without observations.

        :param factor: prior of b, and `spread` its standard deviation.
        """
        self._dt, self._factor, self._spread = dt, factor, spread
        self.position, self.velocity = np.zeros((axes, count)), np.zeros((axes, count))
        self.factor = np.full((axes, count), factor)
        self.covariance = np.zeros((3, 3, count))

    def begin(self, rows: Bools, position: F64, velocity: F64, noise: F64) -> None:
        """Reset rows `(N,)` to their observed state."""
        self.position = np.where(rows, position, self.position)
        self.velocity = np.where(rows, velocity, self.velocity)
        self.factor = np.where(rows, self._factor, self.factor)
        first = np.zeros_like(self.covariance)
        first[0, 0], first[1, 1] = (POSITION * noise)**2, (VELOCITY * noise)**2
        first[2, 2] = self._spread**2
        self.covariance = np.where(rows, first, self.covariance)

    def predict(self, known: F64, times: F64, disturbance: float, wandering: float) -> None:
        """Advance by a step, semi-implicitly like the world.

        :param known: `(A, N)` m/s^2, f.
        :param times: `(N,)` u.
        :param disturbance: m/s^2, standard deviation of unknown accelerations.
        :param wandering: random walk of b, per root of a second.
        """
        dt = self._dt
        self.velocity = self.velocity + (known + self.factor * times) * dt
        self.position = self.position + self.velocity * dt
        p = self.covariance
        # F = [[1, dt, u dt^2], [0, 1, u dt], [0, 0, 1]]
        p = p.copy()
        p[1] += times * dt * p[2]
        p[0] += dt * p[1]
        p[:, 1] += times * dt * p[:, 2]
        p[:, 0] += dt * p[:, 1]
        p[1, 1] += (disturbance * dt)**2
        p[2, 2] += wandering**2 * dt
        self.covariance = p

    def correct(self, position: F64, velocity: F64, noise: F64) -> None:
        """Update with observations `(A, N)` of sensor noise `(N,)`, one by one."""
        for index, seen, deviation in ((0, position, POSITION), (1, velocity, VELOCITY)):
            p = self.covariance
            missed = seen - (self.position if index == 0 else self.velocity)
            gain = p[:, index] / np.maximum(p[index, index] + (deviation * noise)**2, _TINY)
            self.position = self.position + gain[0] * missed
            self.velocity = self.velocity + gain[1] * missed
            self.factor = self.factor + gain[2] * missed
            self.covariance = p - gain[:, None] * p[index][None]


class AxisOfBody:
    """The up vector, `(3, N)`, rotated by the spin, corrected by observations; and its noise."""

    def __init__(self, count: int, dt: float) -> None:
        """Initialise without observations."""
        self._dt = dt
        self._squares = np.zeros(count)
        self.seen = np.zeros(count)
        """`(N,)` number of observations of the current flight."""
        self.up = np.zeros((3, count))

    @property
    def noise(self) -> F64:
        """`(N,)` estimated noise of the sensors, 1 for the deviations above."""
        noise = np.sqrt(self._squares / np.maximum(self.seen - 1, 1.0))
        return np.where(noise < _NONE, 0.0, noise)

    def update(self, state: ObservedState, fresh: Bools) -> None:
        """Update with an observation; `fresh` rows are reset."""
        self.seen = np.where(fresh, 0.0, self.seen) + 1
        before = np.where(fresh, state.up, self.up)
        turned = np.where(fresh, before, turn(before, state.spin, self._dt))
        surprise = state.up - turned
        # A mean of k - 1 axes has a share of the noise itself; two directions are free.
        expected = 2 * ANGLE**2 * (1 + 1 / np.maximum(self.seen - 1, 1.0))
        self._squares = np.where(
            fresh, 0.0, self._squares + (surprise**2).sum(axis=0) / expected)
        turned = turned + surprise / self.seen
        self.up = turned / np.sqrt((turned**2).sum(axis=0))
