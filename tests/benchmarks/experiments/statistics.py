# SPDX-License-Identifier: Apache-2.0
"""Means over several training seeds, with 95 % intervals."""
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from ppo_agent_node.statistics import wilson


class Estimate(NamedTuple):
    """A figure and its 95 % interval."""

    value: float
    low: float
    high: float

    def text(self, digits: int) -> str:
        """Return the figure and its interval as text, with signs."""
        return f'{self.value:+.{digits}f} [{self.low:+.{digits}f}, {self.high:+.{digits}f}]'


def over_seeds(values: Sequence[float]) -> Estimate:
    """Return the mean over training seeds with Student's interval (infinite for one seed).

    For a comparison, pass the differences of each seed; this is then the paired t test.
    """
    sample = np.asarray(values, np.float64)
    if len(sample) < 2:
        return Estimate(float(sample.mean()), -np.inf, np.inf)
    half = stats.t.ppf(0.975, len(sample) - 1) * sample.std(ddof=1) / len(sample)**0.5
    return Estimate(float(sample.mean()), float(sample.mean() - half), float(sample.mean() + half))


def landed(flown: Sequence[dict[str, int]]) -> Estimate:
    """Return the landing rate of all flights of all seeds, in per cent, with Wilson's interval."""
    count, episodes = (sum(one[name] for one in flown) for name in ('landed', 'episodes'))
    low, high = wilson(count, episodes)
    return Estimate(100 * count / episodes, 100 * low, 100 * high)
