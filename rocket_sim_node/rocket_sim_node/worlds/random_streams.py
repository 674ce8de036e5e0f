# SPDX-License-Identifier: Apache-2.0
"""Counter-based random numbers: each episode of each rocket has its own stream.

A spawn is a pure function of (seed, row, episode), independent of the other rockets and their
number. So two pilots can be compared from equal starts, and a roll-out can be repeated from any
moment without saving a generator.
"""
from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.settings import whole_number

# Increments and multipliers of SplitMix64: Steele, Lea, Flood, 'Fast splittable pseudorandom
# number generators', OOPSLA 2014, figure 17 (variant 13 of Stafford's mixers).
_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_AHEAD = 32
"""Maximum episodes of a rocket drawn at once."""
_STORED = 2**16
"""Maximum episodes of all rockets together that are stored."""
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


@lru_cache(maxsize=64)
def _places(draws: int) -> NDArray[np.uint64]:
    places = np.arange(1, draws + 1, dtype=np.uint64)[:, None]
    places.setflags(write=False)
    return places


def check_seed(seed: object) -> int:
    """Return a seed for `reset` as an `int`; it may be an integer of NumPy.

    :raises ValueError: when it is not an integer from 0 to 2**63 - 1.
    """
    return whole_number('seed', seed, 0, 2**63 - 1, '2**63 - 1')


def keys(
    seed: int,
    row: NDArray[np.integer],
    episode: NDArray[np.integer],
    attempt: int = 0,
) -> NDArray[np.uint64]:
    """Return the keys of episodes' streams, `(K,)`, for `numbers`.

    :param seed: any integer from 0 to 2**64 - 1.
    :param row: `(K,)` rockets.
    :param episode: `(K,)` episodes of those rockets.
    :param attempt: another value gives new streams, for rejection sampling.
    """
    # Integer arrays wrap modulo 2**64 without a warning, as the generator requires.
    key = _seed_key(seed)
    for counter in (row.astype(np.uint64), episode.astype(np.uint64), np.uint64(attempt)):
        key = _mix((key ^ counter) + _GAMMA)
    return key


def numbers(
    key: NDArray[np.uint64], draws: int, first: NDArray[np.integer] | int = 0,
) -> NDArray[np.float64]:
    """Return numbers in [-1, 1) of streams, `(draws, K)` float64 with 53 random bits.

    :param key: `(K,)`, as `keys` returns them.
    :param first: how many numbers to skip, one for all streams or `(K,)`.
    """
    place = _places(draws) + np.asarray(first, np.uint64)
    words = _mix(key + place * _GAMMA)
    return (words >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0


def uniform(
    seed: int,
    row: NDArray[np.integer],
    episode: NDArray[np.integer],
    draws: int,
    attempt: int = 0,
) -> NDArray[np.float64]:
    """Return numbers in [-1, 1), `(draws, K)`, equal for equal arguments on every machine.

    The arguments are those of `keys` and `numbers`.
    """
    return numbers(keys(seed, row, episode, attempt), draws)


def normal(
    key: NDArray[np.uint64], draws: int, first: NDArray[np.integer] | int = 0,
) -> NDArray[np.float64]:
    """Return standard normal numbers of streams, `(draws, K)`.

    By Box and Muller, 'A note on the generation of random normal deviates', Annals of
    Mathematical Statistics 29, 1958: two normal numbers from two uniform ones.

    :param key: `(K,)`, as `keys` returns them.
    :param first: how many calls with as many draws to skip, one for all streams or `(K,)`.
    """
    pairs = (draws + 1) // 2
    unit = numbers(key, 2 * pairs, 2 * pairs * np.asarray(first))
    # Halves rather than every second row: NumPy's loops over strides may round differently.
    radius = np.sqrt(-2.0 * np.log((1.0 - unit[:pairs]) * 0.5))
    angle = np.pi * unit[pairs:]
    return np.concatenate((radius * np.cos(angle), radius * np.sin(angle)))[:draws]


class DrawnAhead:
    """Store of the initial values of each rocket's next episodes, drawn many at a time.

    The cost of a draw is mostly per call, and a step rarely ends more than a few episodes. As a
    stream depends on (seed, row, episode) alone, drawing ahead does not change it.
    """

    def __init__(
        self, num_envs: int,
        make: Callable[[NDArray[np.integer], NDArray[np.integer]], tuple[NDArray[Any], ...]],
    ) -> None:
        """Create an empty store.

        :param make: returns arrays `(K, ...)` of initial values for episodes `(K,)` of rows
            `(K,)`.
        """
        self._make = make
        self._ahead = max(1, min(_AHEAD, _STORED // num_envs))
        self._from = np.full(num_envs, -self._ahead)
        none = np.zeros(0, np.int64)
        self._kept = [
            np.zeros((num_envs, self._ahead, *array.shape[1:]), array.dtype)
            for array in make(none, none)]

    def take(
        self, row: NDArray[np.integer], episode: NDArray[np.integer],
    ) -> list[NDArray[Any]]:
        """Return the result of `make` for rows `(K,)` and their episodes."""
        slot = episode - self._from[row]
        missing = np.flatnonzero((slot < 0) | (slot >= self._ahead))
        if missing.size:
            rows, first = row[missing], episode[missing]
            episodes = (first[:, None] + np.arange(self._ahead)).ravel()
            for kept, made in zip(
                    self._kept, self._make(np.repeat(rows, self._ahead), episodes), strict=True):
                kept[rows] = made.reshape(len(rows), self._ahead, *made.shape[1:])
            self._from[rows] = first
            slot[missing] = 0
        return [kept[row, slot] for kept in self._kept]
