# SPDX-License-Identifier: Apache-2.0
"""Settings of the task that a run learns: levels, conditions and observation."""
from __future__ import annotations

from dataclasses import dataclass

from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.rocket import conditions

_CONDITIONS = ('', *conditions.NAMES)


def level_setting(level: int) -> dict[str, float]:
    """Return the reset settings of a curriculum level; none for 0, the world's own."""
    return {'level': level} if level else {}


@dataclass(frozen=True)
class CurriculumConfig:
    """Settings of the curriculum and of the task."""

    curriculum_start_level: int = setting(1, '', 'level of the first roll-out', 0, 8)
    curriculum_final_level: int = setting(
        7, '', 'level to end on, also that of evaluations; 0: the world has no levels', 0, 8)
    curriculum_wide_level: int = setting(
        0, '', "level that every second group of rockets flies in place of the curriculum's, and "
        'that selection and demonstrations fly as well, so that one policy masters both; needs '
        'num_groups of 2 or more; 0: none', 0, 8)
    conditions: str = setting(
        '', '', 'set of conditions that all episodes of the run draw from; empty: as the '
        'simulator was started', choices=_CONDITIONS)
    curriculum_wide_conditions: str = setting(
        '', '', 'set of conditions of those groups; empty: that of the others',
        choices=_CONDITIONS)
    observation: str = setting(
        'standard', '', 'what the policy sees of a rocket; extended: also its last commands and '
        'accelerations, which the simulator has to be started with',
        choices=('standard', 'extended'))
    curriculum_landing_rate: float = setting(
        0.9, '', 'landing rate over the window that advances a level', 0.0, 1.0)
    curriculum_window: int = setting(
        64, 'episodes', 'the most recent that the landing rate is measured over', 1, 1_000_000)
    curriculum_start_reach: float = setting(
        0.0, 'm', 'the reverse curriculum: first of all, roll-outs begin up to so high above '
        "touchdown, the world's spawn_reach, then ever higher; 0: at the spawn height", 0.0, 1e4)
    curriculum_reach_growth: float = setting(
        1.2, '', 'by this factor, when the highest starts land', 1.000001, 1e4)
    curriculum_reach_landing_rate: float = setting(
        0.95, '', 'landing rate over the window that is enough for it', 0.0, 1.0)
    curriculum_reach_hardest: float = setting(
        0.2, '', 'part of the starts, the highest, that this rate is of', 1e-3, 1.0)
    curriculum_heading: float = setting(
        0.0, 'deg', "roll-outs are flown in axes turned by up to it, plus or minus: the world's "
        'spawn_heading; rocket_planar only', 0.0, 180.0)

    @property
    def selection_settings(self) -> tuple[dict[str, float], ...]:
        """Reset settings of the evaluations that select a policy, one for each."""
        plain = self.task_settings(self.curriculum_final_level)
        return (plain, self.wide_settings) if self.curriculum_wide_level else (plain,)

    @property
    def wide_settings(self) -> dict[str, float]:
        """Reset settings of every second group."""
        return self.task_settings(
            self.curriculum_wide_level, self.curriculum_wide_conditions or self.conditions)

    def task_settings(self, level: int, drawn: str | None = None) -> dict[str, float]:
        """Return the reset settings of a level.

        :param drawn: the set of conditions, by default the run's.
        """
        name = self.conditions if drawn is None else drawn
        return {**(conditions.settings(name) if name else {}), **level_setting(level)}

    def reset_settings(self, level: int, group: int = 0) -> dict[str, float]:
        """Return the reset settings of a group's world for roll-outs."""
        wide = group % 2 and self.curriculum_wide_level
        settings = self.wide_settings if wide else self.task_settings(level)
        if self.curriculum_heading:
            settings['spawn_heading'] = self.curriculum_heading
        return settings
