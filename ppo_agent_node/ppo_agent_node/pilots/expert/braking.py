# SPDX-License-Identifier: Apache-2.0
"""Descent profile for an engine that cannot hover: brakes all the way, harder at first.

Heights are above touchdown (m), speeds downwards (m/s), arrays `(N,)` throughout.
"""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

import numpy as np

from ppo_agent_node.pilots.expert.descent import F64
from ppo_agent_node.pilots.expert.descent import TimeToGo


@dataclass(frozen=True)
class BrakingProfile:
    """Speed as a function of height: two parabolas, v^2 = v0^2 + 2 b h below h1, steeper above.

    Above h1 it is v^2 = v1^2 + 2 a (h - h1). The last part brakes with b, halfway between the
    engine's minimum and maximum, so that errors can be corrected in both directions.
    """

    braking: float | F64
    """a, m/s^2."""
    last_braking: float | F64
    """b, m/s^2."""
    join_speed: float | F64
    """v1, m/s."""
    touchdown_speed: float
    """v0, m/s."""
    gravity: float
    """m/s^2."""
    least_braking: float | F64
    """m/s^2, minimum deceleration of a slow descent."""

    @property
    def join_height(self) -> float | F64:
        """h1, m."""
        return (self.join_speed**2 - self.touchdown_speed**2) / (2 * self.last_braking)

    def paced(self, pace: F64) -> BrakingProfile:
        """Return the curve flown at `pace` `(N,)` times the speed, within the engine's limits."""
        braking = np.maximum(self.braking * pace**2, self.least_braking)
        return replace(self, braking=braking, last_braking=np.minimum(self.last_braking, braking))

    def through(self, height: F64, speed: F64) -> BrakingProfile:
        """Return the curve that continues from here, `(N,)` m and m/s, within this curve's limits.

        Its upper deceleration is (v^2 - v1^2) / (2 (h - h1)), or (v^2 - v0^2) / (2 h) when that
        is less than the last one, and between the minimum and this curve's.
        """
        above = np.maximum(height - self.join_height, 0.1)
        needed = (speed**2 - self.join_speed**2) / (2 * above)
        single = (speed**2 - self.touchdown_speed**2) / (2 * np.maximum(height, 0.1))
        needed = np.where(needed < self.last_braking, single, needed)
        braking = np.clip(needed, self.least_braking, self.braking)
        return replace(self, braking=braking, last_braking=np.minimum(self.last_braking, braking))

    def speed(self, height: F64) -> F64:
        """Return the wanted speed `(N,)`."""
        above = np.maximum(height - self.join_height, 0.0)
        below = np.clip(height, 0.0, self.join_height)
        return np.sqrt(self.touchdown_speed**2 + 2 * (
            self.last_braking * below + self.braking * above))

    def next_speed(self, height: F64, dt: float) -> F64:
        """Return the speed `(N,)` that is on the curve after a step of `dt` s.

        The step ends at h - v dt with the new speed v, hence v = speed(h - v dt): with a constant
        deceleration sqrt(speed(h)^2 + (a dt)^2) - a dt.
        """
        step = self.deceleration(self.speed(height)) * dt
        return np.sqrt(self.speed(height)**2 + step**2) - step

    def deceleration(self, speed: F64) -> F64:
        """Return the deceleration `(N,)` m/s^2 on the curve at a speed."""
        return np.where(speed > self.join_speed, self.braking, self.last_braking)

    def burn_time(self, speed: F64) -> F64:
        """Return the time `(N,)` s from a speed on the curve to touchdown."""
        fast = np.maximum(speed - self.join_speed, 0.0) / self.braking
        slow = np.minimum(speed, self.join_speed) - self.touchdown_speed
        return fast + np.maximum(slow, 0.0) / self.last_braking

    def time_to_go(self, height: F64, speed: F64) -> TimeToGo:
        """Return the coast and burn times of an unlit rocket from here, without drag.

        Free fall from (h, v) meets the upper parabola at the height h_i where v^2 + 2 g (h - h_i)
        = v1^2 + 2 a (h_i - h1).
        """
        a, g, v1, h1 = self.braking, self.gravity, self.join_speed, self.join_height
        height = np.maximum(height, 0.0)
        meet = (speed**2 - v1**2 + 2 * g * height + 2 * a * h1) / (2 * (a + g))
        meet = np.where(speed < self.speed(height), np.clip(meet, 0.0, height), height)
        coasting = meet < height
        meet_speed = np.where(coasting, self.speed(meet), np.maximum(speed, self.speed(height)))
        coast = np.where(coasting, np.maximum(meet_speed - speed, 0.0) / g, 0.0)
        return TimeToGo(coast, self.burn_time(meet_speed))


def last_steps(height: F64, speed: F64, touchdown_speed: float, dt: float) -> F64:
    """Return the deceleration `(N,)` m/s^2 of the next step of a descent to the ground.

    An engine that cannot hover must come to rest exactly at the ground, after whole steps. Over
    n of them the decelerations u_i = c + d (i - (n + 1) / 2), i = 1 to n, of least sum of
    squares end at `touchdown_speed` v0 and height 0: with w = v - v0,

        c = w / (n dt),    d = 12 / (n (n^2 - 1)) (c n (n + 1) / 2 - (n v dt - h) / dt^2)

    for steps that move by the new speed. n is that of d = 0, rounded. A single step has one
    degree of freedom and uses it for the height: h / dt is the speed that touches.
    """
    exact = (speed - touchdown_speed + 2 * height / dt) / np.maximum(speed + touchdown_speed, 1e-9)
    steps = np.maximum(np.rint(exact), 1.0)
    mean = (speed - touchdown_speed) / (steps * dt)
    short = mean * steps * (steps + 1) / 2 - (steps * speed * dt - height) / dt**2
    ramp = 12 * short / np.maximum(steps * (steps**2 - 1), 1.0)
    several = mean - ramp * (steps - 1) / 2
    return np.where(steps > 1, several, (speed - height / dt) / dt)
