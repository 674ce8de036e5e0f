# SPDX-License-Identifier: Apache-2.0
"""Stop criterion of fine-tuning: iterations, episodes or target return; and a run's result."""
from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ppo_agent_node.runs.metrics_logger import Progress
from ppo_agent_node.training.selection import Score


@dataclass(frozen=True)
class Result:
    """Result of a run."""

    finished: bool
    """False when it was stopped; it can be resumed."""
    iterations: int
    """Completed iterations of fine-tuning."""
    best: Score | None
    """Score of the policy in `policy`; None before the first evaluation."""
    policy: Path


@dataclass(frozen=True)
class StopCriterion:
    """Limits that end a run's fine-tuning."""

    iterations: int
    episodes: int
    """Maximum number of episodes; 0: unlimited."""
    target_return: float = math.inf
    """Mean return of an evaluation without noise that suffices."""

    def reached(
        self, iteration: int, episodes: int, best_return: float = -math.inf,
    ) -> bool:
        """Return whether a run is done.

        :param iteration: completed iterations.
        :param episodes: completed episodes.
        :param best_return: highest mean return of an evaluation without noise so far.
        """
        return (
            iteration >= self.iterations or 0 < self.episodes <= episodes
            or best_return >= self.target_return)

    def progress(self, iteration: int, episodes: int) -> Progress:
        """Return the progress, in terms of the limit expected to be reached first."""
        if not self.episodes or iteration * self.episodes > episodes * self.iterations:
            return Progress(iteration, self.iterations, 'iterations')
        return Progress(min(episodes, self.episodes), self.episodes, 'episodes')

    def left(self, iteration: int, episodes: int) -> float:
        """Return the expected number of remaining iterations, at the present rate of episodes."""
        left = self.iterations - iteration
        if not self.episodes or not episodes:
            return left
        return min(left, max(0, self.episodes - episodes) * iteration / episodes)
