# SPDX-License-Identifier: Apache-2.0
"""The random streams against SplitMix64 written again in whole numbers, and as statistics."""
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from rocket_sim_node.worlds import random_streams

GAMMA = 0x9E3779B97F4A7C15
WORD = 2**64 - 1


def mix(word: int) -> int:
    """Return SplitMix64's output function of a 64-bit word."""
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & WORD
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & WORD
    return word ^ (word >> 31)


def stream(seed: int, row: int, episode: int, draws: int, attempt: int) -> list[float]:
    """Return what `uniform` promises for one rocket, from Python's whole numbers."""
    key = mix((seed + GAMMA) & WORD)
    for counter in (row, episode, attempt):
        key = mix(((key ^ counter) + GAMMA) & WORD)
    words = [mix((key + k * GAMMA) & WORD) for k in range(1, draws + 1)]
    return [(word >> 11) * 2.0**-52 - 1.0 for word in words]


def many(seed: int, count: int, draws: int = 4, episode: int = 0) -> NDArray[np.float64]:
    """Return the draws of `count` rockets in one of their episodes."""
    return random_streams.uniform(seed, np.arange(count), np.full(count, episode), draws)


def test_the_mixer_gives_the_published_splitmix64_sequence() -> None:
    """Seed 1234567: the five numbers that implementations of SplitMix64 are checked with."""
    assert [mix(1234567 + k * GAMMA & WORD) for k in range(1, 6)] == [
        6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431,
        16408922859458223821,
    ]


@pytest.mark.parametrize('seed', [0, 1, 2**63 - 1, 2**64 - 1])
@pytest.mark.parametrize('attempt', [0, 1, 999])
def test_numbers_are_those_of_whole_number_arithmetic(seed: int, attempt: int) -> None:
    """No overflow, rounding or sign differs from arithmetic modulo 2**64."""
    rows, episodes = np.array([0, 1, 255, 999_999]), np.array([0, 7, 2**40, 3])
    got = random_streams.uniform(seed, rows, episodes, 10, attempt)
    assert got.shape == (10, 4)
    assert got.dtype == np.float64
    for column, (row, episode) in enumerate(zip(rows.tolist(), episodes.tolist(), strict=True)):
        assert got[:, column].tolist() == stream(seed, row, episode, 10, attempt)


def test_a_stream_does_not_depend_on_other_rockets() -> None:
    """A rocket alone, among others or in another order draws the same bits."""
    rows, episodes = np.array([5, 0, 9]), np.array([2, 8, 2])
    together = random_streams.uniform(3, rows, episodes, 6)
    for column in range(3):
        alone = random_streams.uniform(3, rows[[column]], episodes[[column]], 6)
        assert np.array_equal(alone[:, 0], together[:, column])
    assert np.array_equal(random_streams.uniform(3, rows[::-1], episodes[::-1], 6),
                          together[:, ::-1])


def test_fewer_draws_are_the_beginning_of_more() -> None:
    """The count of draws does not enter the key."""
    assert np.array_equal(many(1, 8, draws=2), many(1, 8, draws=10)[:2])


def test_numbers_are_uniform_from_minus_one_to_one() -> None:
    """Kolmogorov-Smirnov and the first moments, 200 000 numbers."""
    numbers = many(11, 50_000).ravel()
    assert numbers.min() >= -1
    assert numbers.max() < 1
    assert stats.kstest(numbers, 'uniform', args=(-1, 2)).pvalue > 1e-3
    deviation = np.sqrt(1 / 3 / numbers.size)
    assert abs(numbers.mean()) < 4 * deviation
    assert numbers.var() == pytest.approx(1 / 3, rel=0.01)


def test_neighbouring_streams_are_independent() -> None:
    """Next seed, row, episode, draw and attempt: no correlation beyond four deviations."""
    count = 50_000
    rows, zero = np.arange(count), np.zeros(count, np.int64)
    base = many(4, count)[0]
    neighbours = {
        'seed': many(5, count)[0],
        'row': many(4, count + 1)[0, 1:],
        'episode': many(4, count, episode=1)[0],
        'draw': many(4, count)[1],
        'attempt': random_streams.uniform(4, rows, zero, 1, attempt=1)[0],
        'row and episode exchanged': random_streams.uniform(4, zero + 1, rows, 1)[0],
    }
    for name, numbers in neighbours.items():
        assert abs(np.corrcoef(base, numbers)[0, 1]) < 4 / np.sqrt(count), name
        assert not (base == numbers).any(), name


def test_normal_numbers_are_normal_and_each_stream_has_its_own() -> None:
    """Moments within five standard errors of 20 000; what is passed over is what came before."""
    keys = random_streams.keys(3, np.arange(20_000), np.zeros(20_000, np.int64))
    drawn = random_streams.normal(keys, 3)
    assert drawn.shape == (3, 20_000)
    error = 5 / np.sqrt(20_000)
    assert np.abs(drawn.mean(axis=1)).max() < error
    assert np.abs(drawn.var(axis=1) - 1).max() < error * np.sqrt(2)
    assert np.abs((drawn**4).mean(axis=1) - 3).max() < error * np.sqrt(96)
    assert np.abs(np.corrcoef(drawn) - np.eye(3)).max() < error
    later = random_streams.normal(keys, 3, 1)
    assert abs(np.corrcoef(drawn[0], later[0])[0, 1]) < error
    mixed = random_streams.normal(keys[:2], 3, np.array([0, 1]))
    assert np.array_equal(mixed, np.stack((drawn[:, 0], later[:, 1]), axis=1))
