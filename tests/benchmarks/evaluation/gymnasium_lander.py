# SPDX-License-Identifier: Apache-2.0
"""Gymnasium's LunarLander-v3, flown by our pilots: the reference for world `lunar_lander`."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

NAME = 'LunarLander-v3'
_LANDED = 100.0


@dataclass(frozen=True)
class Flown:
    """Results of some episodes, `(K,)` each."""

    episode_return: NDArray[np.float64]
    length: NDArray[np.int64]
    outcomes: dict[str, int]
    """number of episodes by outcome; Gymnasium does not tell leaving the field from a crash"""


def fly(
    pilot: Callable[[NDArray[np.float32]], NDArray[Any]], episodes: int, seed: int,
    continuous: bool = False, num_envs: int = 20,
) -> Flown:
    """Fly the same number of episodes in each environment, to avoid a bias to short ones.

    :param pilot: maps observations `(N, 8)` to actions.
    :param episodes: rounded up to a multiple of `num_envs`.
    """
    env = gymnasium.make_vec(
        NAME, num_envs=num_envs, vectorization_mode='sync', continuous=continuous,
        vector_kwargs={'autoreset_mode': AutoresetMode.SAME_STEP})
    observation, _ = env.reset(seed=seed)
    left = np.full(num_envs, -(-episodes // num_envs))
    score, age = np.zeros(num_envs), np.zeros(num_envs, np.int64)
    scores: list[float] = []
    lengths: list[int] = []
    outcomes: Counter[str] = Counter()
    while left.any():
        observation, reward, terminated, truncated, _ = env.step(
            pilot(observation.astype(np.float32)))
        score += reward
        age += 1
        for row in np.flatnonzero(terminated | truncated).tolist():
            if left[row]:
                left[row] -= 1
                scores.append(float(score[row]))
                lengths.append(int(age[row]))
                outcomes[_outcome(float(reward[row]), bool(terminated[row]))] += 1
            score[row], age[row] = 0.0, 0
    env.close()
    return Flown(np.array(scores), np.array(lengths), dict(outcomes))


def _outcome(reward: float, terminated: bool) -> str:
    if not terminated:
        return 'timeout'
    return 'landed' if reward == _LANDED else 'crashed or out_of_bounds'
