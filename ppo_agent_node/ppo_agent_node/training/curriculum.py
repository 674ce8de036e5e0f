# SPDX-License-Identifier: Apache-2.0
"""Curriculum: raises the level when the policy lands often enough. A state machine."""
from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import replace

from ppo_agent_node.config.curriculum_config import CurriculumConfig


@dataclass(frozen=True)
class Curriculum:
    """A level and the most recent episodes flown on it; `advance` returns its successor."""

    config: CurriculumConfig
    level: int
    recent: tuple[bool, ...] = ()
    """Whether each of the last episodes landed, at most one window, oldest first."""

    @classmethod
    def begin(cls, config: CurriculumConfig) -> Curriculum:
        """Return the curriculum at its first level."""
        return cls(config, config.curriculum_start_level)

    @property
    def landed(self) -> int:
        """Number of landings within the window."""
        return sum(self.recent)

    @property
    def landing_rate(self) -> float:
        """Fraction of the window's episodes that landed; NaN before the first."""
        return self.landed / len(self.recent) if self.recent else float('nan')

    @property
    def final(self) -> bool:
        """Whether this is the last level."""
        return self.level >= self.config.curriculum_final_level

    def advance(self, landed: Iterable[bool]) -> Curriculum:
        """Return the curriculum after more episodes, in the order in which they ended.

        It moves up one level, with an empty window, when the window is full and the landing rate
        over it reaches the threshold. It never moves down.
        """
        window = self.config.curriculum_window
        recent = (*self.recent, *map(bool, landed))[-window:]
        successor = replace(self, recent=recent)
        ready = len(recent) == window and (
            successor.landing_rate >= self.config.curriculum_landing_rate)
        if ready and not self.final:
            return replace(self, level=self.level + 1, recent=())
        return successor
