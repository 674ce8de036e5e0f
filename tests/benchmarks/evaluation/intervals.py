# SPDX-License-Identifier: Apache-2.0
"""Means and differences of means with their 95 % intervals, as text and numbers."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats


def mean_line(values: NDArray[np.float64]) -> str:
    """Return mean and standard deviation of a sample."""
    return f'{values.mean():7.1f} ± {values.std(ddof=1):5.1f}'


def difference(
    ours: NDArray[np.float64], theirs: NDArray[np.float64],
) -> tuple[float, float, float]:
    """Return the difference of two means and its 95 % interval (Welch's t)."""
    interval = stats.ttest_ind(ours, theirs, equal_var=False).confidence_interval(0.95)
    return float(ours.mean() - theirs.mean()), float(interval.low), float(interval.high)
