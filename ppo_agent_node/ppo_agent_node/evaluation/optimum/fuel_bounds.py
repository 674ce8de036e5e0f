# SPDX-License-Identifier: Apache-2.0
"""Minimum fuel of a straight landing, as a reference for fuel figures.

For a soft landing straight down with bounded thrust, free end time and fuel as the cost, the
maximum principle allows one switch: free fall, then full throttle until speed and height vanish
together (Meditch, 'On the problem of optimal thrust programming for a lunar soft landing', IEEE
Transactions on Automatic Control 9, 1964). Braking later and harder loses less to gravity, as
each second in flight under power costs g of the speed that fuel buys; drag makes a fast coast even
better. So no straight drop to rest takes less fuel, in continuous time.

Limits. A touchdown need not be at rest: at 3 m/s, which still counts as landed, some 30 kg less
suffice. Flights that start off the axis, drifting or tilted need more, which the bound ignores. A
world that advances in steps deviates by what one step at full throttle burns (3.4 kg).
"""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_BURN_STEPS = 50
_BISECTIONS = 45
_TABLE_SIZE = 257


class StraightDropBound:
    """Minimum fuel of vertical drops from one height, for any initial speed.

    With q the flow and c v^2 the drag at full throttle, a burn of length T ends at rest at
    touchdown height with the mass m0 - q T. Integrating backwards from there by T gives height and
    speed at its beginning; free fall from the start gives a speed at that height. The two agree
    at one T, found by bisection.
    """

    def __init__(self, settings: Mapping[str, float], spawn_height: float | None = None) -> None:
        """Store the vehicle's constants.

        :param settings: of a rocket world, by name, as in `WorldSpec.settings`.
        :param spawn_height: m, if it differs from that of the settings.
        :raises KeyError: when a constant is missing.
        """
        height = settings['spawn_height'] if spawn_height is None else spawn_height
        self.drop = height - settings['touchdown_height']
        self.mass = settings['dry_mass'] + settings['fuel']
        self.gravity = settings['gravity']
        self.thrust = settings['max_thrust']
        exhaust_speed = settings['specific_impulse'] * self.gravity
        self.flow = self.thrust / exhaust_speed if exhaust_speed else 0.0
        self.drag = (
            0.5 * settings['air_density'] * settings['drag_coefficient'] * settings['drag_area'])
        self.longest_burn = settings['fuel'] / self.flow if self.flow else 0.0
        self._table: tuple[F64, F64] | None = None

    def fuel(self, velocity: F64) -> F64:
        """Return the minimum fuel `(K,)` kg; NaN if full tanks and full throttle cannot stop it.

        Interpolated in a table over the speed, to better than 0.01 kg.

        :param velocity: `(K,)` m/s, vertical and upwards, at the start. A climb counts as rest,
            so that the result remains a lower bound.
        """
        speed = np.maximum(-np.asarray(velocity, np.float64), 0.0)
        if not speed.size:
            return speed
        fastest = float(np.nan_to_num(speed).max())
        if self._table is None or self._table[0][-1] < fastest:
            grid = np.linspace(0.0, max(1.25 * fastest, 1.0), _TABLE_SIZE)
            self._table = grid, self.flow * self.burn_time(grid)
        fuel: F64 = np.interp(speed, *self._table)
        # Between the last speed of the table that can be stopped and the first that cannot.
        doubtful = np.isnan(fuel)
        fuel[doubtful] = self.flow * self.burn_time(speed[doubtful])
        return fuel

    def burn_time(self, speed: F64) -> F64:
        """Return the burn times `(K,)` s, given the downward speed at the start, m/s."""
        low = np.zeros_like(speed)
        high = np.full_like(speed, self.longest_burn)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            height, ignition_speed = self._ignition(middle)
            # A longer burn consumes more height and speed than the drop supplies.
            enough = (height >= self.drop) | (ignition_speed >= self._fall(speed, height))
            low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        height, ignition_speed = self._ignition(high)
        met = np.abs(ignition_speed - self._fall(speed, height)) < 1e-6
        return np.where(met, high, np.nan)

    def _fall(self, speed: F64, height: F64) -> F64:
        """Return the speed `(K,)` of free fall at a height above touchdown.

        m v dv/ds = m g - c v^2 gives v^2 = v0^2 e^-x + 2 g s (1 - e^-x) / x, x = 2 c s / m.
        """
        fallen = np.maximum(self.drop - height, 0.0)
        x = 2 * self.drag * fallen / self.mass
        mean_decay = np.where(x > 1e-12, -np.expm1(-x) / np.maximum(x, 1e-12), 1.0)
        return np.sqrt(speed**2 * np.exp(-x) + 2 * self.gravity * fallen * mean_decay)

    def _ignition(self, burn: F64) -> tuple[F64, F64]:
        """Return height and downward speed `(K,)` at which burns of that length must begin.

        Runge-Kutta of fourth order, backwards in time from rest at touchdown.
        """
        dt = burn / _BURN_STEPS
        end_mass = self.mass - self.flow * burn
        height, speed = np.zeros_like(burn), np.zeros_like(burn)

        def braking(before: F64, speed: F64) -> F64:
            force = self.thrust + self.drag * speed * np.abs(speed)
            return force / (end_mass + self.flow * before) - self.gravity

        for step in range(_BURN_STEPS):
            before = step * dt
            k1 = braking(before, speed)
            k2 = braking(before + dt / 2, speed + dt / 2 * k1)
            k3 = braking(before + dt / 2, speed + dt / 2 * k2)
            k4 = braking(before + dt, speed + dt * k3)
            height = height + dt * speed + dt**2 / 6 * (k1 + k2 + k3)
            speed = speed + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return height, speed
