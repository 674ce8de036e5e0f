# SPDX-License-Identifier: Apache-2.0
"""Scores of training episodes: console lines, moving averages and log entries."""
from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.statistics import wilson
from rocket_sim_node.worlds import Episodes

WINDOW = 50
"""Number of episodes in an average."""


def moving_average(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, for each of the scores `(K,)`, the mean of it and of the 49 before."""
    sums = np.cumsum(np.concatenate(([0.0], scores)))
    end = np.arange(1, len(scores) + 1)
    begin = np.maximum(end - WINDOW, 0)
    average: NDArray[np.float64] = (sums[end] - sums[begin]) / (end - begin)
    return average


class ScoreLines:
    """Numbers the episodes of a run and formats a line about each."""

    def __init__(self, planned: int) -> None:
        """Start with episode 1.

        :param planned: episodes of the whole run; 0: unknown.
        """
        self._total = f'/{planned}' if planned else ''
        self._count = 0
        self._recent: deque[float] = deque(maxlen=WINDOW)

    def add(self, scores: Iterable[float]) -> list[str]:
        """Return the lines of the next episodes, given their returns."""
        lines = []
        for score in scores:
            self._count += 1
            self._recent.append(score)
            average = sum(self._recent) / len(self._recent)
            lines.append(f'episode: {self._count}{self._total}, score: {score:.1f}, '
                         f'average: {average:.1f}')
        return lines


def landed(episodes: Episodes, outcomes: tuple[str, ...]) -> list[bool]:
    """Return which episodes landed, K of them.

    :param outcomes: names of the world's outcomes.
    """
    return [bool(one) for one in episodes.outcome == outcomes.index('landed')]


def figures(
    episodes: Episodes, outcomes: tuple[str, ...], copies: int = 1,
) -> dict[str, Any]:
    """Return the values of a log line that summarise ended episodes.

    :param copies: number of episodes with the same start. Their outcomes are correlated, so the
        interval of the landing rate counts them as one; at worst it is too wide.
    """
    if not len(episodes):
        return {'episodes': 0}
    count = sum(landed(episodes, outcomes))
    low, high = wilson(count / copies, len(episodes) / copies)
    return {
        'episodes': len(episodes), 'landing_rate': count / len(episodes),
        'landing_rate_low': low, 'landing_rate_high': high,
        'mean_return': float(np.mean(episodes.episode_return)),
        'mean_length': float(np.mean(episodes.length)),
    }
