# SPDX-License-Identifier: Apache-2.0
"""Averages of values with gaps; null, not NaN, if there are no values."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def mean(values: NDArray[np.float64]) -> float | None:
    """Return the mean of the finite values, None if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else None


def spread(values: NDArray[np.float64]) -> dict[str, float | None]:
    """Return `mean` and `p95`, the 95th percentile, of the finite values; None without values."""
    finite = values[np.isfinite(values)]
    return {
        'mean': mean(finite),
        'p95': float(np.quantile(finite, 0.95)) if finite.size else None,
    }
