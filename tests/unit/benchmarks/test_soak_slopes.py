# SPDX-License-Identifier: Apache-2.0
"""Slopes that a soak calls flat."""
from __future__ import annotations

import numpy as np
import pytest
from benchmarks.reliability import soak
from benchmarks.reliability.soak_slopes import at_age
from benchmarks.reliability.soak_slopes import fit
from benchmarks.reliability.soak_slopes import in_blocks

HOURS = np.tile(np.linspace(0.0, 0.5, 30), 3) + np.repeat([0.0, 0.5, 1.0], 30)
LIVES = np.repeat([0.0, 1.0, 2.0], 30)
LEVELS = np.repeat([100.0, 140.0, 90.0], 30)
"""three lives of half an hour, each with a level of its own"""


def test_one_slope_within_lives_whatever_their_levels() -> None:
    slope = fit(HOURS, LEVELS + 7.0 * HOURS, LIVES)
    assert slope is not None
    assert slope.per_hour == pytest.approx(7.0)
    assert slope.low == pytest.approx(7.0)
    assert slope.high == pytest.approx(7.0)
    assert (slope.lives, slope.points) == (3, 90)
    assert not slope.flat
    falling = fit(HOURS, LEVELS - 7.0 * HOURS, LIVES)
    assert falling is not None
    assert not falling.flat


def test_no_slope_and_one_that_means_nothing_are_flat() -> None:
    for per_hour in (0.0, 0.5):  # of 110
        slope = fit(HOURS, LEVELS + per_hour * HOURS, LIVES)
        assert slope is not None
        assert slope.flat


def test_the_interval_holds_the_slope_as_often_as_it_says() -> None:
    """Of residuals that hang together; 95 % of 400 is 380, and the method is good for many."""
    random, held = np.random.default_rng(1), 0
    for _ in range(400):
        noise = random.normal(size=len(HOURS) + 1)
        slope = fit(HOURS, LEVELS + 7.0 * HOURS + noise[1:] + noise[:-1], LIVES)
        assert slope is not None
        held += slope.low <= 7.0 <= slope.high
    assert 350 <= held <= 395


def test_too_little_to_say() -> None:
    nothing = np.array([])
    assert fit(nothing, nothing, nothing) is None
    assert fit(HOURS[:2], LEVELS[:2], LIVES[:2]) is None
    assert fit(np.zeros(5), np.arange(5.0), np.zeros(5)) is None


def test_blocks_leave_out_the_warm_up_of_each_life() -> None:
    seconds = np.arange(0.0, 600.0, 5.0)
    lives = (seconds >= 300.0).astype(np.float64)
    values = np.where(seconds % 300.0 < 120.0, 1000.0, 5.0 + lives)
    hours, means, names = in_blocks(seconds, values, lives, 120.0, 60.0)
    assert means.tolist() == [5.0, 5.0, 5.0, 6.0, 6.0, 6.0]
    assert names.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    assert hours[0] == pytest.approx(np.mean(np.arange(120.0, 180.0, 5.0)) / 3600.0)


def test_of_a_long_life_the_first_third_is_left_out() -> None:
    seconds = np.arange(0.0, 900.0, 5.0)
    values = np.where(seconds < 295.0, 1000.0, 5.0)
    _, means, _ = in_blocks(seconds, values, np.zeros(len(seconds)), 10.0, 60.0)
    assert set(means) == {5.0}


def test_short_lives_are_left_out_when_asked() -> None:
    seconds = np.arange(0.0, 900.0, 5.0)
    lives = (seconds >= 100.0).astype(np.float64)
    _, _, names = in_blocks(seconds, seconds, lives, 10.0, 60.0, shortest=200.0)
    assert set(names) == {1.0}
    none = in_blocks(seconds, seconds, lives, 10.0, 60.0, shortest=2000.0)
    assert fit(*none) is None


def test_lives_are_compared_at_the_same_age() -> None:
    """Each begins at 10 and grows by 1 a second; the last is too short."""
    seconds = np.arange(0.0, 210.0, 5.0)
    lives = seconds // 100.0
    values = 10.0 + seconds % 100.0 + 3.0 * lives
    hours, found, ones = at_age(seconds, values, lives, 30.0)
    assert (hours * 3600.0).tolist() == pytest.approx([30.0, 130.0])
    assert found.tolist() == [40.0, 43.0]
    assert ones.tolist() == [1.0, 1.0]


def test_failures_name_growing_figures() -> None:
    def row(what: str, per_hour: float, flat: bool | None) -> dict[str, object]:
        return {'what': what, 'of': 'sim_0', 'per_hour': per_hour, 'flat': flat}

    good = [
        row('open files', 1.0, True), row('open files', -1.0, False), row('threads', 1.0, None),
        row('steps/s', -900.0, False), row('steps per piece of work', 9.0, False)]
    assert soak.failures({'slopes': good, 'unexpected': []}) == []
    bad = [row('open files', 1.0, False), row('steps per piece of work', -9.0, False)]
    assert soak.failures({'slopes': good + bad, 'unexpected': ['sim_1 ended']}) == [
        'sim_1 ended', 'open files of sim_0: +1 an hour',
        'steps per piece of work of sim_0: -9 an hour']
