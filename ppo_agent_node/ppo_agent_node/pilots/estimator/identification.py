# SPDX-License-Identifier: Apache-2.0
"""In-flight identification of a vehicle from its commands and observed motion.

Least squares on a bank of models, one for each possible delay and engine lag (multiple model
estimation: Magill, 'Optimal adaptive estimation of sampled stochastic processes', 1965). The RCS
has no lag, so turns reveal the delay. The vertical acceleration, which is not affected by
horizontal disturbances, reveals lag and strength of the engine. The rest of the horizontal
acceleration is the side acceleration.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.expert.observed_state import ObservedState
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

DELAYS = 6
"""Number of modelled delays: 0 to 5 steps."""
LAGS = np.linspace(0.0, 0.3, 25)
"""s, modelled time constants."""
_STRENGTH, _TURNING = (0.8, 1.25), (0.4, 1.2)
"""Bounds of the factors of engine and RCS."""


@dataclass
class Estimate:
    """Estimated properties of N vehicles."""

    delay: NDArray[np.int64]
    """`(N,)` steps."""
    lag: F64
    """`(N,)` s."""
    strength: F64
    """`(N,)`, factor of the engine's acceleration."""
    turning: F64
    """`(N,)`, factor of the RCS's angular acceleration."""
    side: F64
    """`(2, N)` m/s^2, along x and z."""
    fall: F64
    """`(N,)` m/s^2, upward acceleration beyond nominal gravity, measured before ignition."""
    throttle: F64
    """`(N,)`, actual throttle of the engine."""


class Identification:
    """Identifies N vehicles, row by row."""

    def __init__(
        self, vehicle: RocketSettings, count: int, memory: float, expected: float,
        spread: float,
    ) -> None:
        """Initialise with the nominal vehicle.

        :param memory: s, time constant for forgetting measurements of the side acceleration.
        :param expected: prior factor of the engine's acceleration.
        :param spread: standard deviation of that factor among vehicles.
        """
        self._vehicle, self._expected, self._spread = vehicle, expected, spread
        self._kept = np.exp(-vehicle.dt / memory)
        self._lag_kept = np.exp(-vehicle.dt / np.maximum(LAGS, 1e-9))[None, :, None]
        self._drag = 0.5 * vehicle.air_density * vehicle.drag_coefficient * vehicle.drag_area
        self._rows = np.arange(count)
        self.commands = np.zeros((DELAYS, 3, count))
        """Throttle, torque about X and Z of the last steps, newest first, as applied."""
        self._throttle = np.zeros((DELAYS, len(LAGS), count))
        self._turned = np.zeros((3, DELAYS, count))
        self._pushed = np.zeros((3, DELAYS, len(LAGS), count))
        self._side, self._side_weight = np.zeros((2, count)), np.zeros(count)
        self._fall, self._fallen = np.zeros(count), np.zeros(count)
        self._before: ObservedState | None = None
        self._variance = np.full(count, _EXACT**2)

    def forget(self, rows: Bools) -> None:
        """Reset the marked rows `(N,)`."""
        for array in (self.commands, self._throttle, self._turned, self._pushed, self._side,
                      self._side_weight, self._fall, self._fallen):
            array[..., rows] = 0.0

    def command(self, throttle: F64, torque: F64) -> None:
        """Record a command: throttle `(N,)` 0 to 1 and torque `(2, N)`."""
        self.commands[1:] = self.commands[:-1]
        self.commands[0, 0] = np.where(throttle > self._vehicle.throttle_cutoff, throttle, 0.0)
        self.commands[0, 1:] = torque
        asked = self.commands[:, None, 0]
        self._throttle = asked + (self._throttle - asked) * self._lag_kept

    def learn(self, state: ObservedState, mass: F64, known: Bools, noise: F64) -> Estimate:
        """Update with the step that ended, and return the new estimate.

        :param mass: `(N,)` kg, nominal, during the step.
        :param known: `(N,)` rows for which the start of the step was observed too.
        :param noise: `(N,)` m/s, standard deviation of the observed speeds.
        """
        v, before = self._vehicle, self._before
        self._before = state
        self._variance = _EXACT**2 + 2 * (noise / v.dt)**2
        if before is None or not known.any():
            return self.estimate()
        # Expanded into sums of y y, y u and u u for each model y = factor u.
        turn = (state.spin - before.spin)[::2] / v.dt
        asked = self.commands[:, 1:] * (v.rcs_torque / v.inertia)
        self._turned += np.stack((
            np.broadcast_to((turn**2).sum(axis=0), asked[:, 0].shape),
            (turn * asked).sum(axis=1), (asked**2).sum(axis=1))) * known
        change = (state.velocity - before.velocity) / v.dt
        drag = self._drag * np.sqrt((before.velocity**2).sum(axis=0)) / mass
        change += drag * before.velocity
        change[1] += v.gravity
        idle = known & ~self._throttle.any(axis=(0, 1))
        self._fallen += idle
        self._fall += idle * change[1]
        change[1] -= self._mean_fall()
        full = v.max_thrust / mass
        # Nothing is added to rows that are not known. In place, as these arrays are large.
        model = self._throttle * (full * before.up[1] * known)
        squares, product, power = self._pushed
        squares += change[1]**2 * known
        product += change[1] * model
        power += model**2
        found = self.estimate()
        push = found.throttle * found.strength * full * before.up[::2]
        weight = self._kept * self._side_weight + known
        share = known / np.maximum(weight, 1.0)
        self._side += share * (change[::2] - push - self._side)
        self._side_weight = weight
        return found

    def _mean_fall(self) -> F64:
        """Return the acceleration `(N,)` m/s^2 of falls beyond gravity; 0 until measured."""
        fall: F64 = self._fall / (self._fallen + self._variance / _FALL_SPREAD**2)
        return fall

    def estimate(self) -> Estimate:
        """Return the current estimate: the most likely models, and the side acceleration."""
        rows = self._rows
        squares, product, power = self._turned
        turning = _fit(product, power, 1.0, 1e-3, _TURNING)
        delay = np.argmin(squares - 2 * turning * product + turning**2 * power + _SLIGHT *
                          np.arange(DELAYS)[:, None], axis=0)
        squares, product, power = self._pushed[:, delay, :, rows].transpose(1, 2, 0)
        weight = self._variance / self._spread**2
        strength = _fit(product, power, self._expected, weight, _STRENGTH)
        misfit = (squares - 2 * strength * product + strength**2 * power) / self._variance
        misfit += weight * (strength - self._expected)**2 / self._variance
        lag = np.argmin(misfit + _AKAIKE * (LAGS > 0)[:, None], axis=0)
        return Estimate(
            delay, LAGS[lag], strength[lag, rows], turning[delay, rows], self._side,
            self._mean_fall(), self._throttle[delay, lag, rows])


_EXACT = 0.05
"""m/s^2, model error in the absence of noise."""
_FALL_SPREAD = 0.1
"""m/s^2, standard deviation of gravity."""
_AKAIKE = 2.0
"""Minimum gain of a lag, in units of the variance of noise: one parameter (Akaike, 1974)."""
_SLIGHT = 1e-6
"""(m/s^2)^2 or (rad/s^2)^2, by which the first of equivalent models is preferred."""


def _fit(
    product: F64, power: F64, expected: float, weight: float | F64, bounds: tuple[float, float],
) -> F64:
    """Return the least-squares factor, regularised towards the expected one."""
    factor: F64 = np.clip(
        (product + weight * expected) / (power + weight), *bounds)
    return factor
