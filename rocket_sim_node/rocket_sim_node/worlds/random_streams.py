# SPDX-License-Identifier: Apache-2.0
"""Counter-based random numbers: every rocket's every episode has a stream of its own.

A spawn is a pure function of (seed, row, episode), whatever the other rockets do and however many
there are. So two pilots can be compared from equal starts, and a roll-out can be repeated from
any moment without saving a generator.
"""
from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# Increments and multipliers of SplitMix64: Steele, Lea, Flood, 'Fast splittable pseudorandom
# number generators', OOPSLA 2014, figure 17 (variant 13 of Stafford's mixers).
_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)


def _mix(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    word = word ^ (word >> _SHIFT_1)
    word *= _MIX_1
    word ^= word >> _SHIFT_2
    word *= _MIX_2
    word ^= word >> _SHIFT_3
    return word


@lru_cache(maxsize=16)
def _seed_key(seed: int) -> NDArray[np.uint64]:
    key = _mix(np.full(1, seed, np.uint64) + _GAMMA)
    key.setflags(write=False)
    return key


def uniform(
    seed: int,
    row: NDArray[np.integer],
    episode: NDArray[np.integer],
    draws: int,
    attempt: int = 0,
) -> NDArray[np.float64]:
    """Return numbers in [-1, 1), the same for the same arguments on every machine.

    :param seed: any whole number from 0 to 2**64 - 1.
    :param row: `(K,)` rockets.
    :param episode: `(K,)` episodes of those rockets.
    :param draws: how many numbers for each, D.
    :param attempt: another value gives fresh numbers, for rejection sampling.
    :return: `(D, K)` float64 with 53 random bits.
    """
    # Arrays of whole numbers wrap modulo 2**64 without a warning: what the generator is made of.
    key = _seed_key(seed)
    for counter in (row.astype(np.uint64), episode.astype(np.uint64), np.uint64(attempt)):
        key = _mix((key ^ counter) + _GAMMA)
    steps = np.arange(1, draws + 1, dtype=np.uint64)[:, None] * _GAMMA
    words = _mix(key + steps)
    return (words >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0
