# SPDX-License-Identifier: Apache-2.0
"""Kalman filters of noisy sights, which learn how noisy they are and what pushes the vehicle.

Position and velocity are noisy, and so is the up vector, but not the spin: an axis that is turned
by the spin seen tells the noise of the one that is seen next. Where there is none, sights are
passed on as they are. (Kalman, 'A new approach to linear filtering and prediction problems',
1960.)
"""
from __future__ import annotations

import numpy as np

from ppo_agent_node.pilots.expert.observed_state import ObservedState
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools

POSITION, VELOCITY, ANGLE = 0.5, 0.2, np.deg2rad(1.0)
"""m, m/s and rad: standard deviations of a sensor noise of 1."""
_NONE = 0.02
"""noise below which there is taken to be none"""


_TINY = 1e-30


def turn(axis: F64, spin: F64, dt: float) -> F64:
    """Return an axis `(3, N)` after a step of turning with `spin` `(3, N)` rad/s (Rodrigues)."""
    rate = np.maximum(np.sqrt((spin**2).sum(axis=0)), 1e-12)
    about, angle = spin / rate, rate * dt
    turned: F64 = (
        axis * np.cos(angle) + np.cross(about, axis, axis=0) * np.sin(angle)
        + about * (about * axis).sum(axis=0) * (1 - np.cos(angle)))
    return turned


class AxisFilter:
    """Filters position, velocity and a factor of a known acceleration, `(A, N)` each.

    x'' = f + b u, with f and u known and b to be learnt; A axes that are alike share `covariance`
    `(3, 3, N)`, of x, v and b.
    """

    def __init__(self, axes: int, count: int, dt: float, factor: float, spread: float) -> None:
        """Begin with nothing seen.

        :param factor: b before anything is seen, and `spread` its standard deviation.
        """
        self._dt, self._factor, self._spread = dt, factor, spread
        self.position, self.velocity = np.zeros((axes, count)), np.zeros((axes, count))
        self.factor = np.full((axes, count), factor)
        self.covariance = np.zeros((3, 3, count))

    def begin(self, rows: Bools, position: F64, velocity: F64, noise: F64) -> None:
        """Begin rows `(N,)` anew where they are seen."""
        self.position = np.where(rows, position, self.position)
        self.velocity = np.where(rows, velocity, self.velocity)
        self.factor = np.where(rows, self._factor, self.factor)
        first = np.zeros_like(self.covariance)
        first[0, 0], first[1, 1] = (POSITION * noise)**2, (VELOCITY * noise)**2
        first[2, 2] = self._spread**2
        self.covariance = np.where(rows, first, self.covariance)

    def predict(self, known: F64, times: F64, disturbance: float, wandering: float) -> None:
        """Advance by a step, semi-implicitly as the world does.

        :param known: `(A, N)` m/s^2, f.
        :param times: `(N,)` u.
        :param disturbance: m/s^2, standard deviation of what is not known.
        :param wandering: of b, in the root of a second.
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
        """Learn from what is seen, `(A, N)`, with sensors of this noise `(N,)`: one by one."""
        for index, seen, deviation in ((0, position, POSITION), (1, velocity, VELOCITY)):
            p = self.covariance
            missed = seen - (self.position if index == 0 else self.velocity)
            gain = p[:, index] / np.maximum(p[index, index] + (deviation * noise)**2, _TINY)
            self.position = self.position + gain[0] * missed
            self.velocity = self.velocity + gain[1] * missed
            self.factor = self.factor + gain[2] * missed
            self.covariance = p - gain[:, None] * p[index][None]


class AxisOfBody:
    """The up vector, `(3, N)`, turned by the spin and corrected by what is seen; its noise."""

    def __init__(self, count: int, dt: float) -> None:
        """Begin with nothing seen."""
        self._dt = dt
        self._squares = np.zeros(count)
        self.seen = np.zeros(count)
        """`(N,)` sights of the flight so far"""
        self.up = np.zeros((3, count))

    @property
    def noise(self) -> F64:
        """`(N,)` the noise of the sensors, 1 for the deviations above, as far as is known."""
        noise = np.sqrt(self._squares / np.maximum(self.seen - 1, 1.0))
        return np.where(noise < _NONE, 0.0, noise)

    def update(self, state: ObservedState, fresh: Bools) -> None:
        """Take note of what is seen; `fresh` rows begin anew."""
        self.seen = np.where(fresh, 0.0, self.seen) + 1
        before = np.where(fresh, state.up, self.up)
        turned = np.where(fresh, before, turn(before, state.spin, self._dt))
        surprise = state.up - turned
        # A mean of k - 1 axes is itself off by a share of the noise; two directions are free.
        expected = 2 * ANGLE**2 * (1 + 1 / np.maximum(self.seen - 1, 1.0))
        self._squares = np.where(
            fresh, 0.0, self._squares + (surprise**2).sum(axis=0) / expected)
        turned = turned + surprise / self.seen
        self.up = turned / np.sqrt((turned**2).sum(axis=0))
