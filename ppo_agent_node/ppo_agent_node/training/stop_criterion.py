# SPDX-License-Identifier: Apache-2.0
"""When fine-tuning ends, after its iterations or episodes or once it is good enough, and how."""
from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ppo_agent_node.runs.metrics_logger import Progress
from ppo_agent_node.training.selection import Score


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    finished: bool
    """False when it was stopped; it can be resumed"""
    iterations: int
    """done, of fine-tuning"""
    best: Score | None
    """of the policy in `policy`; None when none has been flown yet"""
    policy: Path


@dataclass(frozen=True)
class StopCriterion:
    """What ends a run's fine-tuning."""

    iterations: int
    episodes: int
    """0: as many as there are"""
    target_return: float = math.inf
    """mean return of a flight without noise"""

    def reached(
        self, iteration: int, episodes: int, best_return: float = -math.inf,
    ) -> bool:
        """Tell whether a run is done.

        :param iteration: iterations it did.
        :param episodes: episodes it saw.
        :param best_return: most that a flight without noise returned on average so far.
        """
        return (
            iteration >= self.iterations or 0 < self.episodes <= episodes
            or best_return >= self.target_return)

    def progress(self, iteration: int, episodes: int) -> Progress:
        """Return how far it is, counted in what will end it if it goes on as so far."""
        if not self.episodes or iteration * self.episodes > episodes * self.iterations:
            return Progress(iteration, self.iterations, 'iterations')
        return Progress(min(episodes, self.episodes), self.episodes, 'episodes')

    def left(self, iteration: int, episodes: int) -> float:
        """Return how many iterations are to come, if episodes end as often as so far."""
        left = self.iterations - iteration
        if not self.episodes or not episodes:
            return left
        return min(left, max(0, self.episodes - episodes) * iteration / episodes)
