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

    curriculum_start_level: int = setting(1, '', 'curriculum level of the first roll-out', 0, 8)
    curriculum_final_level: int = setting(
        7, '', 'last curriculum level, also used for evaluation; 0: the world has no levels', 0, 8)
    curriculum_wide_level: int = setting(
        0, '', "level flown by every second group of rockets instead of the curriculum's level, "
        'and also by demonstrations and, with selection_wide, by selections, so that one policy '
        'learns both; needs num_groups of 2 or more; 0: none', 0, 8)
    conditions: str = setting(
        '', '', "set of conditions from which all episodes of the run are drawn; empty: the "
        "simulator's own", choices=_CONDITIONS)
    curriculum_wide_conditions: str = setting(
        '', '', 'set of conditions for the groups of curriculum_wide_level; empty: the same as '
        'for the others',
        choices=_CONDITIONS)
    selection_wide: bool = setting(
        True, '', 'whether selections also fly curriculum_wide_level with its conditions')
    curriculum_nominal_share: float = setting(
        0.0, '', "probability that each condition of an episode stays nominal (the world's "
        'nominal_share), in demonstrations and roll-outs, so that vehicles that differ in only '
        'one condition occur as well', 0.0, 0.99)
    observation: str = setting(
        'standard', '', 'observation of a rocket; extended: also its last commands and '
        'accelerations. The simulator must be started with the same value',
        choices=('standard', 'extended'))
    curriculum_landing_rate: float = setting(
        0.9, '', 'landing rate over the window at which the level rises', 0.0, 1.0)
    curriculum_window: int = setting(
        64, 'episodes', 'number of most recent episodes over which the landing rate is '
        'measured', 1, 1_000_000)
    curriculum_start_reach: float = setting(
        0.0, 'm', "reverse curriculum: the first roll-outs begin at heights up to this one above "
        "touchdown (the world's spawn_reach), later ones higher; 0: no reverse "
        'curriculum', 0.0, 1e4)
    curriculum_reach_growth: float = setting(
        1.2, '', 'factor by which that height grows when the highest starts land', 1.000001, 1e4)
    curriculum_reach_landing_rate: float = setting(
        0.95, '', 'landing rate of the highest starts at which the height grows; above 1: never, '
        'for a curriculum_start_reach of the full drop and a single level', 0.0, 2.0)
    curriculum_reach_hardest: float = setting(
        0.2, '', 'fraction of the starts that counts as the highest', 1e-3, 1.0)
    curriculum_heading: float = setting(
        0.0, 'deg', "maximum rotation of the axes in roll-outs, plus or minus (the world's "
        'spawn_heading); rocket_planar only', 0.0, 180.0)

    @property
    def reach_is_fixed(self) -> bool:
        """Whether roll-outs begin at heights up to the first reach throughout the run."""
        return self.curriculum_start_reach > 0 and self.curriculum_reach_landing_rate > 1

    @property
    def selection_settings(self) -> tuple[dict[str, float], ...]:
        """Reset settings of the evaluations that select a policy, one for each."""
        plain = self.task_settings(self.curriculum_final_level)
        wide = self.curriculum_wide_level and self.selection_wide
        return (plain, self.wide_settings) if wide else (plain,)

    @property
    def wide_settings(self) -> dict[str, float]:
        """Reset settings of every second group."""
        return self.task_settings(
            self.curriculum_wide_level, self.curriculum_wide_conditions or self.conditions)

    @property
    def learning_settings(self) -> dict[str, float]:
        """Reset settings of demonstrations and roll-outs beyond those of the task."""
        share = self.curriculum_nominal_share
        return {'nominal_share': share} if share else {}

    def task_settings(self, level: int, drawn: str | None = None) -> dict[str, float]:
        """Return the reset settings of a level.

        :param drawn: the set of conditions, by default the run's.
        """
        name = self.conditions if drawn is None else drawn
        return {**(conditions.settings(name) if name else {}), **level_setting(level)}

    def reset_settings(self, level: int, group: int = 0) -> dict[str, float]:
        """Return the reset settings of a group's world for roll-outs."""
        wide = group % 2 and self.curriculum_wide_level
        settings = {
            **(self.wide_settings if wide else self.task_settings(level)),
            **self.learning_settings}
        if self.curriculum_heading:
            settings['spawn_heading'] = self.curriculum_heading
        return settings
