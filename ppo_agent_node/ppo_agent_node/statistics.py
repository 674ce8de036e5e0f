# SPDX-License-Identifier: Apache-2.0
"""Confidence intervals of rates and means over a finite number of episodes."""
from __future__ import annotations

from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray

Interval = tuple[float, float]

BOOTSTRAPPED = 20_000
"""Maximum number of values for a bootstrap; with more, the mean is practically normal."""
_CHUNK = 2_000_000


def wilson(successes: float, trials: float, confidence: float = 0.95) -> Interval:
    """Return the Wilson score interval of a proportion.

    Unlike the normal approximation it stays within 0 and 1 and does not vanish at 0 or all
    successes (Wilson, 'Probable inference, the law of succession, and statistical inference',
    JASA 22, 1927; Brown, Cai and DasGupta, Statistical Science 16, 2001).

    :param trials: may be fractional, as an effective number of dependent trials.
    :raises ValueError: unless 0 <= successes <= trials, 1 <= trials, 0 < confidence < 1.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f'got {successes} of {trials}, expected 0 <= successes <= trials, >= 1')
    if not 0 < confidence < 1:
        raise ValueError(f'confidence: got {confidence}, expected between 0 and 1')
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    rate = successes / trials
    denominator = 1 + z * z / trials
    centre = (rate + z * z / (2 * trials)) / denominator
    half = z / denominator * (rate * (1 - rate) / trials + z * z / (4 * trials**2)) ** 0.5
    # At the ends the exact limits are 0 and 1; rounding would miss them by 1e-17.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return low, high


def bootstrap_mean(
    values: ArrayLike, confidence: float = 0.95, resamples: int = 2000, seed: int = 0,
) -> Interval:
    """Return the percentile bootstrap interval of a mean.

    It assumes nothing about the distribution, which with a few crashes at -100 among landings near
    290 is far from normal (Efron and Tibshirani, 'An introduction to the bootstrap', 1993, chapter
    13). Equal arguments give equal results.

    :param values: `(K,)`.
    :raises ValueError: for no values, or ones that are not finite.
    """
    sample: NDArray[np.float64] = np.asarray(values, np.float64).ravel()
    if not sample.size or not np.isfinite(sample).all():
        raise ValueError(f'expected finite values, got {sample.size} of which '
                         f'{int(np.isfinite(sample).sum())} are')
    generator = np.random.default_rng(seed)
    rows = max(1, _CHUNK // sample.size)
    means = np.concatenate([
        sample[generator.integers(sample.size, size=(min(rows, resamples - done), sample.size))]
        .mean(axis=1)
        for done in range(0, resamples, rows)
    ])
    tail = (1 - confidence) / 2
    low, high = np.quantile(means, (tail, 1 - tail))
    return float(low), float(high)


def mean_interval(values: NDArray[np.float64]) -> Interval:
    """Return the 95 % interval of a mean of finite values `(K,)`."""
    if len(values) <= BOOTSTRAPPED:
        return bootstrap_mean(values)
    half = NormalDist().inv_cdf(0.975) * float(values.std()) / len(values)**0.5
    return float(values.mean()) - half, float(values.mean()) + half
