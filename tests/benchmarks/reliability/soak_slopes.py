# SPDX-License-Identifier: Apache-2.0
"""Whether a figure stays flat: its slope per hour, with a 95 % interval.

A node is killed and restarted; the time between two restarts is called a life. Each life has a
level of its own, so this is a least-squares fit with one slope and one intercept per life. The
first third of a life, when a process fills its buffers and discovers other nodes, is left out,
because a leak would continue after it. Memory changes slowly, so samples are correlated: values
are averaged over blocks, and the interval is that of Newey and West (Econometrica 55, 1987, eq.
5), which allows for residuals that are correlated over a few blocks.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

FLAT = 0.01
"""part of the mean, per hour; a smaller slope is negligible"""
WARM_UP = 1 / 3
"""part of a life"""
_LAG = 3
"""number of blocks over which residuals may be correlated"""
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Slope:
    """A slope per hour, with the number of lives and points of the fit."""

    mean: float
    per_hour: float
    low: float
    high: float
    lives: int
    points: int

    @property
    def flat(self) -> bool:
        """Whether the interval contains zero, or the slope is negligible."""
        return self.low <= 0.0 <= self.high or abs(self.per_hour) < FLAT * abs(self.mean)


def fit(hours: Values, values: Values, lives: Values, lag: int = _LAG) -> Slope | None:
    """Fit one slope, with one intercept per life; None if there are too few points.

    :param hours: (n,), in order
    :param lives: (n,), number of the life of each value
    """
    names, place = np.unique(lives, return_inverse=True)
    freedom = len(values) - len(names) - 1
    if freedom < 1:
        return None
    count = np.bincount(place)
    t = hours - (np.bincount(place, hours) / count)[place]
    v = values - (np.bincount(place, values) / count)[place]
    spread = float(t @ t)
    if spread == 0.0:
        return None
    slope = float(t @ v) / spread
    score = t * (v - slope * t)
    variance = float(score @ score)
    for distance in range(1, min(lag, len(score) - 1) + 1):
        together = place[distance:] == place[:-distance]
        variance += 2 * (1 - distance / (lag + 1)) * float(
            score[distance:] @ (score[:-distance] * together))
    error = np.sqrt(max(0.0, variance) * len(values) / freedom) / spread
    reach = float(stats.t.ppf(0.975, freedom) * error)
    return Slope(float(values.mean()), slope, slope - reach, slope + reach, len(names),
                 len(values))


def in_blocks(
    seconds: Values, values: Values, lives: Values, warm_up: float, block: float,
    shortest: float = 0.0,
) -> tuple[Values, Values, Values]:
    """Leave out the beginning of each life and average the rest over blocks of time.

    :param warm_up: s from the first point of a life; WARM_UP of the life if that is longer
    :param block: s
    :param shortest: s; shorter lives are left out
    :return: hours, values and lives of the blocks, in order of time within each life.
    """
    parts = []
    for life in np.unique(lives):
        own = lives == life
        t, v = seconds[own], values[own]
        if t[-1] - t[0] < shortest:
            continue
        late = t >= t[0] + max(warm_up, WARM_UP * (t[-1] - t[0]))
        t, v = t[late], v[late]
        number = np.floor(t / block).astype(np.int64)
        for one in np.unique(number):
            chosen = number == one
            parts.append((t[chosen].mean() / 3600.0, v[chosen].mean(), life))
    return tuple(np.array(parts, np.float64).reshape(-1, 3).T)  # type: ignore[return-value]


def at_age(
    seconds: Values, values: Values, lives: Values, age: float,
) -> tuple[Values, Values, Values]:
    """Return one value of each life, at the same age: the first at this age or later.

    :param age: s from the first point of a life; shorter lives are left out
    :return: hours, values, and ones, because all values count as one life.
    """
    points = []
    for life in np.unique(lives):
        own = lives == life
        t, v = seconds[own], values[own]
        old = np.flatnonzero(t >= t[0] + age)
        if len(old):
            points.append((t[old[0]] / 3600.0, v[old[0]], 1.0))
    return tuple(np.array(points, np.float64).reshape(-1, 3).T)  # type: ignore[return-value]
