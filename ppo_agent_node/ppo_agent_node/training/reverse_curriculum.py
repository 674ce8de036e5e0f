# SPDX-License-Identifier: Apache-2.0
"""Reverse curriculum: episodes begin near the ground, then ever higher. A state machine.

Florensa et al., 'Reverse curriculum generation for reinforcement learning', 2017: with a reward at
the end only, learn backwards, from starts near the goal. A rocket at rest a few decimetres above
the ground lands whatever it does; from there on each reach prepares for the next one.
"""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace

from ppo_agent_node.config.curriculum_config import CurriculumConfig
from ppo_agent_node.ppo.rollout_buffer import Ended
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds import full_reach
from rocket_sim_node.worlds import start_heights

_ALMOST = 0.999
"""Least fraction of the drop that counts as the full one, for a reach that a preset rounds."""


@dataclass(frozen=True)
class ReverseCurriculum:
    """Start height of episodes, and the results of the hardest recent ones; see `advance`."""

    config: CurriculumConfig
    full_reach: float
    """m, the full drop of the task."""
    reach: float
    """m, the world's `spawn_reach`; 0: all episodes begin at the usual height."""
    recent: tuple[bool, ...] = ()
    """Whether each of the last hard episodes landed, at most one window, oldest first."""

    @classmethod
    def begin(cls, config: CurriculumConfig, spec: WorldSpec) -> ReverseCurriculum:
        """Return the curriculum at its first reach, 0 without a reverse curriculum.

        :raises ValueError: when the first reach is more than the world's drop, or less and can
            never grow.
        """
        first = config.curriculum_start_reach
        full = full_reach(spec) if first else 0.0
        if first > full:
            raise ValueError(
                f'curriculum_start_reach: got {first:g}, expected at most the full drop of the '
                f'task, {full:g} m')
        if config.reach_is_fixed and first < _ALMOST * full:
            raise ValueError(
                f'curriculum_reach_landing_rate: got {config.curriculum_reach_landing_rate:g}, '
                f'expected at most 1 with curriculum_start_reach {first:g} below the full drop '
                f'of the task, {full:g} m')
        return cls(config, full, first)

    @property
    def over(self) -> bool:
        """Whether roll-outs have the ordinary starts."""
        return not self.reach

    @property
    def landing_rate(self) -> float:
        """Fraction of the window's episodes that landed; NaN before the first."""
        return sum(self.recent) / len(self.recent) if self.recent else float('nan')

    def figures(self) -> dict[str, float]:
        """Return values for the log: the height, m, at which the highest episodes begin."""
        return {'reach': self.reach or self.full_reach} if self.full_reach else {}

    def reset_settings(self, group: int = 0) -> dict[str, float]:
        """Return the reset settings of a group's roll-outs, besides the level.

        Once all heights are learnt, every second group still begins at all of them: from the
        highest starts alone, a policy that no longer lands would not learn to land again.
        """
        if self.over:
            return {'spawn_reach': self.full_reach} if group % 2 and self.full_reach else {}
        return {'spawn_reach': self.reach}

    def advance(self, landed: Iterable[bool]) -> ReverseCurriculum:
        """Return the curriculum after more of the hardest episodes, in the order they ended.

        When the window is full and the landing rate over it reaches the threshold, the reach
        grows, with an empty window: up to that of the full task, and then to the ordinary starts.
        It never shrinks.
        """
        if self.over:
            return self
        config = self.config
        recent = (*self.recent, *map(bool, landed))[-config.curriculum_window:]
        successor = replace(self, recent=recent)
        if len(recent) < config.curriculum_window or (
                successor.landing_rate < config.curriculum_reach_landing_rate):
            return successor
        grown = min(self.reach * config.curriculum_reach_growth, self.full_reach)
        return replace(self, reach=0.0 if self.reach == self.full_reach else grown, recent=())

    def hardest(self, ended: Sequence[Ended], world_seed: int) -> list[Ended]:
        """Return those of a group's episodes that began highest.

        :param world_seed: of the world's last reset: it determines each episode's start,
            independent of observations.
        """
        least = 1.0 - self.config.curriculum_reach_hardest
        return [
            (step, episodes.take(
                start_heights.reach_share(world_seed, episodes.row, episodes.episode) > least))
            for step, episodes in ended]
