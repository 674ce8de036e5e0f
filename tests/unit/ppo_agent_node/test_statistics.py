# SPDX-License-Identifier: Apache-2.0
"""Intervals against published values and closed forms."""
from __future__ import annotations

import numpy as np
import pytest

from ppo_agent_node.statistics import bootstrap_mean
from ppo_agent_node.statistics import wilson


# Newcombe, 'Two-sided confidence intervals for the single proportion: comparison of seven
# methods', Statistics in Medicine 17, 1998, table I, method 3 (score without correction).
@pytest.mark.parametrize(('successes', 'trials', 'low', 'high'), [
    (81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605),
    (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718),
])
def test_wilson_gives_newcombes_table(
    successes: int, trials: int, low: float, high: float,
) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_at_the_ends_is_exact_and_symmetric() -> None:
    low, high = wilson(2000, 2000)
    assert (low, high) == pytest.approx((0.998083, 1.0), abs=1e-6)
    assert high == 1.0
    assert wilson(0, 2000) == pytest.approx((1 - high, 1 - low))
    # All of n: the lower limit is n / (n + z^2).
    assert wilson(50, 50)[0] == pytest.approx(50 / (50 + 1.959964**2), abs=1e-6)


@pytest.mark.parametrize(('successes', 'trials'), [(-1, 5), (6, 5), (0, 0)])
def test_wilson_refuses_invalid_proportions(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match='successes'):
        wilson(successes, trials)
    with pytest.raises(ValueError, match='confidence'):
        wilson(1, 2, confidence=1.0)


def test_bootstrap_agrees_with_the_normal_interval_where_that_holds() -> None:
    values = np.random.default_rng(1).normal(290.0, 4.0, 2000)
    half = 1.959964 * values.std(ddof=1) / np.sqrt(len(values))
    low, high = bootstrap_mean(values)
    assert low == pytest.approx(values.mean() - half, abs=0.05 * half * 2)
    assert high == pytest.approx(values.mean() + half, abs=0.05 * half * 2)


def test_bootstrap_covers_the_mean_as_often_as_it_claims() -> None:
    generator = np.random.default_rng(2)
    covered = 0
    for trial in range(300):
        sample = generator.exponential(1.0, 100)
        low, high = bootstrap_mean(sample, resamples=400, seed=trial)
        covered += low <= 1.0 <= high
    assert 0.90 < covered / 300 < 0.98


def test_bootstrap_is_reproducible_and_collapses_for_a_constant() -> None:
    values = np.random.default_rng(3).random(50)
    assert bootstrap_mean(values) == bootstrap_mean(values)
    assert bootstrap_mean(values) != bootstrap_mean(values, seed=1)
    assert bootstrap_mean([3.0, 3.0, 3.0]) == (3.0, 3.0)
    with pytest.raises(ValueError, match='finite'):
        bootstrap_mean([])
    with pytest.raises(ValueError, match='finite'):
        bootstrap_mean([1.0, float('nan')])
