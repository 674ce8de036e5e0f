# SPDX-License-Identifier: Apache-2.0
"""Descent profile of a hoverslam: speed over height, and time to go.

Coast in free fall until the speed meets the braking parabola, brake on it, and remove the rest of
the speed in a short exponential flare. Heights are above touchdown (m), speeds downwards (m/s).
All functions work on arrays `(N,)`.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


class TimeToGo(NamedTuple):
    """Time until touchdown, in two parts."""

    coast: F64
    """`(N,)` s, remaining free fall."""
    burn: F64
    """`(N,)` s, braking and flare."""


class Descent(Protocol):
    """A descent profile, speed over height."""

    @property
    def braking(self) -> float | F64:
        """Deceleration at great height, m/s^2."""
        ...

    @property
    def join_speed(self) -> float | F64:
        """Speed at which the last part of the curve begins, m/s."""
        ...

    @property
    def join_height(self) -> float | F64:
        """Height at which the last part of the curve begins, m."""
        ...

    def paced(self, pace: F64) -> Descent:
        """Return the same curve flown at `pace` `(N,)` times the speed."""
        ...

    def speed(self, height: F64) -> F64:
        """Return the wanted speed `(N,)`."""
        ...

    def next_speed(self, height: F64, dt: float) -> F64:
        """Return the speed `(N,)` that is on the curve after a step of `dt` s."""
        ...

    def deceleration(self, speed: F64) -> F64:
        """Return the deceleration `(N,)` m/s^2 on the curve at a speed."""
        ...

    def time_to_go(self, height: F64, speed: F64) -> TimeToGo:
        """Return the coast and burn times of a rocket from here."""
        ...


@dataclass(frozen=True)
class DescentProfile:
    """Speed as a function of height: v^2 = v1^2 + 2 a (h - h1) above h1, v = k h + v0 below.

    Both parts and their slopes agree at the join: a / v1 = k, hence v1 = a / k and
    h1 = (v1 - v0) / k. Braking has the constant deceleration a, the flare k v. Each of the three
    numbers is common to all rockets or `(N,)`.
    """

    braking: float | F64
    """a, m/s^2."""
    flare_rate: float | F64
    """k, 1/s."""
    touchdown_speed: float | F64
    """v0, m/s."""
    gravity: float
    """m/s^2."""

    @property
    def join_speed(self) -> float | F64:
        """v1, m/s."""
        return self.braking / self.flare_rate

    @property
    def join_height(self) -> float | F64:
        """h1, m."""
        return (self.join_speed - self.touchdown_speed) / self.flare_rate

    def paced(self, pace: F64) -> DescentProfile:
        """Return the same curve flown at `pace` `(N,)` times the speed, in 1 / pace the time.

        The touchdown speed is unchanged, so that a slow descent does not stall above the ground.
        """
        return DescentProfile(
            self.braking * pace**2, self.flare_rate * pace,
            np.minimum(self.touchdown_speed, 0.5 * pace * self.join_speed), self.gravity)

    def speed(self, height: F64) -> F64:
        """Return the wanted speed `(N,)`; below touchdown height the flare becomes a climb."""
        above = np.maximum(height - self.join_height, 0.0)
        braking = np.sqrt(self.join_speed**2 + 2 * self.braking * above)
        flare = self.flare_rate * height + self.touchdown_speed
        return np.where(height > self.join_height, braking, flare)

    def next_speed(self, height: F64, dt: float) -> F64:
        """Return the speed `(N,)` that is on the curve after a step of `dt` s.

        The step is semi-implicit: it ends at h - v dt with the new speed v, hence v solves
        v = speed(h - v dt). On the parabola that is v = sqrt(speed(h)^2 + (a dt)^2) - a dt, on
        the flare v = speed(h) / (1 + k dt). The plain feed-forward, a differential equation in
        steps, would stall above the ground where the two differ.
        """
        step = self.braking * dt
        braking = np.sqrt(self.speed(height)**2 + step**2) - step
        flare = (self.flare_rate * height + self.touchdown_speed) / (1 + self.flare_rate * dt)
        return np.where(braking > self.join_speed, braking, flare)

    def deceleration(self, speed: F64) -> F64:
        """Return the deceleration `(N,)` m/s^2 on the curve at a speed; 0 in a climb."""
        return np.clip(self.flare_rate * speed, 0.0, self.braking)

    def time_to_go(self, height: F64, speed: F64) -> TimeToGo:
        """Return the coast and burn times of a rocket from here, without drag.

        Free fall from (h, v) meets the parabola at the height h_i where v^2 + 2 g (h - h_i) =
        v1^2 + 2 a (h_i - h1). Braking then lasts (v_i - v1) / a and the flare from a height h_f,
        a solution of dh/dt = -(k h + v0), ln((k h_f + v0) / v0) / k.
        """
        a, g, v1, h1 = self.braking, self.gravity, self.join_speed, self.join_height
        height = np.maximum(height, 0.0)
        meet = (speed**2 - v1**2 + 2 * g * height + 2 * a * h1) / (2 * (a + g))
        meet = np.where(speed < self.speed(height), np.clip(meet, 0.0, height), height)
        meet_speed = self.speed(meet)
        coast = np.where(meet < height, np.maximum(meet_speed - speed, 0.0) / g, 0.0)
        braking = np.maximum(np.maximum(meet_speed, np.where(coast > 0, 0.0, speed)) - v1, 0.0) / a
        flare = np.log1p(self.flare_rate * np.minimum(meet, h1) / self.touchdown_speed)
        return TimeToGo(coast, braking + flare / self.flare_rate)
