# SPDX-License-Identifier: Apache-2.0
"""The curriculum: when the level rises."""
from __future__ import annotations

import math

from ppo_agent_node.config.curriculum_config import CurriculumConfig
from ppo_agent_node.training.curriculum import Curriculum

CONFIG = CurriculumConfig(
    curriculum_start_level=1, curriculum_final_level=3, curriculum_landing_rate=0.8,
    curriculum_window=10)


def test_the_curriculum_begins_at_the_first_level_without_a_rate() -> None:
    begun = Curriculum.begin(CONFIG)
    assert begun.level == 1
    assert math.isnan(begun.landing_rate)


def test_a_window_that_is_not_full_never_advances() -> None:
    assert Curriculum.begin(CONFIG).advance([True] * 9).level == 1


def test_a_full_window_at_the_rate_advances_and_empties() -> None:
    moved = Curriculum.begin(CONFIG).advance([True] * 8 + [False] * 2)
    assert moved.level == 2
    assert moved.recent == ()
    assert Curriculum.begin(CONFIG).advance([True] * 7 + [False] * 3).level == 1


def test_only_the_most_recent_episodes_count() -> None:
    now = Curriculum.begin(CONFIG).advance([False] * 50)
    assert now.level == 1
    assert len(now.recent) == 10
    now = now.advance([True] * 7)
    assert (now.level, now.landing_rate) == (1, 0.7)
    assert now.advance([True]).level == 2


def test_one_level_at_a_time_up_to_the_final_one_and_never_down() -> None:
    now = Curriculum.begin(CONFIG)
    for level in (2, 3, 3):
        now = now.advance([True] * 1000)
        assert now.level == level
    assert now.final
    assert now.advance([False] * 1000).level == 3


def test_advancing_does_not_change_a_curriculum() -> None:
    begun = Curriculum.begin(CONFIG)
    begun.advance([True] * 10)
    assert begun == Curriculum.begin(CONFIG)
