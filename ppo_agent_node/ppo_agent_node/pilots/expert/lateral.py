# SPDX-License-Identifier: Apache-2.0
"""Lateral guidance law: to rest on the pad's axis when the burn ends, then upright.

Positions and speeds are `(2, N)`, along x and z, in m and m/s; times `(N,)` s.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ppo_agent_node.pilots.expert.descent import F64
from ppo_agent_node.pilots.expert.descent import TimeToGo


class Pull(NamedTuple):
    """Lateral acceleration demanded by the guidance law."""

    acceleration: F64
    """`(2, N)` m/s^2."""
    rate: F64
    """`(2, N)` m/s^3, its rate of change; 0 while the rocket coasts."""


class Drifting(NamedTuple):
    """A trajectory to the axis under a constant side acceleration; arrays `(2, N)`."""

    x: F64
    """m."""
    drift: F64
    """m/s."""
    opposed: F64
    """m/s^2, compensated part of the side acceleration."""
    opposed_rate: F64
    """m/s^3, its rate of change."""


def drift_upright(side: F64, time: F64, upright_time: float) -> Drifting:
    """Return the state at `time` before touchdown that leads to rest, on the axis, upright.

    A rocket leans against a side acceleration w, except for the last T = `upright_time`, in which
    it leans less and less: then w (1 - t / T) remains and decelerates a rocket that comes from
    windward with w T / 2. Hence v = -w (t - t^2 / 2T) and x = w (t^2 / 2 - t^3 / 6T) for t < T.

    :param side: `(2, N)` m/s^2.
    :param time: `(N,)` s.
    """
    last = np.minimum(time, upright_time)
    speed = last - last**2 / (2 * upright_time)
    x = last**2 / 2 - last**3 / (6 * upright_time) + speed * (time - last)
    falling = np.where(time < upright_time, -1 / upright_time, 0.0)
    return Drifting(side * x, -side * speed, side * (last / upright_time), side * falling)


@dataclass(frozen=True)
class LateralLaw:
    """A critically damped law whose time constant shrinks with the remaining burn time.

    With t the remaining burn time, x'' = -p^2 x / t^2 - (2 p - 1) x' / t has the double root x =
    t^p: critically damped in log t, and at rest on the axis at touchdown without tilt for p > 2.
    (p = 3.5 is, except for 12.25 instead of 12, the guidance of the Apollo lander: Klumpp, 'Apollo
    lunar descent guidance', Automatica 10, 1974.)
    """

    power: float
    """p."""
    least_time: float | F64
    """s, lower limit of t."""
    reach: float
    """m/s^2, available to stop the approach from far away."""
    upright_time: float
    """s, remaining burn time below which the acceleration is faded out, to land upright."""

    def pull(self, x: F64, drift: F64, push: F64, to_go: TimeToGo) -> Pull:
        """Return the acceleration towards the axis and its rate.

        Far away, the approach speed is limited to what `reach` can stop. The law is evaluated at
        the position where the burn begins, as there is no control before.

        :param push: `(2, N)` m/s^2, the present lateral acceleration.
        """
        pull, stiffness, damping, shrinking = self._law(x, drift, to_go)
        rate = -(stiffness * drift + damping * push)
        time = np.maximum(to_go.burn, self.least_time)
        bounded = stiffness < self.power**2 / time**2
        stiffening = np.where(bounded, 0.0, 2 * stiffness)
        rate -= shrinking * (stiffening * x + damping * drift) / time
        fade = np.minimum(to_go.burn / self.upright_time, 1.0)
        rate = rate * fade - np.where(fade < 1, pull / self.upright_time, 0.0)
        return Pull(pull * fade, np.where(to_go.coast > 0, 0.0, rate))

    def first_pull(self, x: F64, drift: F64, to_go: TimeToGo) -> F64:
        """Return the acceleration `(2, N)` m/s^2 before fading."""
        return self._law(x, drift, to_go)[0]

    def _law(self, x: F64, drift: F64, to_go: TimeToGo) -> tuple[F64, F64, F64, F64]:
        """Return acceleration, stiffness (1/s^2), damping (1/s), and 1 if t shrinks, else 0."""
        time = np.maximum(to_go.burn, self.least_time)
        damping = (2 * self.power - 1) / time
        begin = x + drift * to_go.coast
        stoppable = np.sqrt(2 * self.reach / np.maximum(np.hypot(*begin), 1e-12))
        approach = np.minimum(self.power**2 / time**2 / damping, stoppable)
        pull = -damping * (approach * begin + drift)
        shrinking = (to_go.burn > self.least_time).astype(np.float64)
        return pull, damping * approach, damping, shrinking

    def shortest(self, x: F64, drift: F64) -> F64:
        """Return the shortest time `(N,)` s from x and drift `(2, N)` to rest on the axis.

        For each axis under |x''| <= A it is s v / A + 2 sqrt(v^2 / (2 A^2) + s x / A), with s the
        sign of x + v |v| / (2 A): the time-optimal double integrator (Bryson and Ho, 'Applied
        optimal control', 1975, section 3.9). From rest it grows with the root of the distance, so
        fourth powers of times add like squares of distances.
        """
        side = np.where(x + drift * np.abs(drift) / (2 * self.reach) < 0, -1.0, 1.0)
        inside = np.maximum((drift / self.reach)**2 / 2 + side * x / self.reach, 0.0)
        each = side * drift / self.reach + 2 * np.sqrt(inside)
        shortest: F64 = (each**4).sum(axis=0)**0.25
        return shortest
