# SPDX-License-Identifier: Apache-2.0
"""The reverse curriculum: the state machine of start heights, and which episodes count."""
from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from ppo_agent_node.config.curriculum_config import CurriculumConfig
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.training.reverse_curriculum import ReverseCurriculum
from rocket_sim_node import worlds
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import start_heights

CONFIG = CurriculumConfig(
    curriculum_start_reach=0.4, curriculum_reach_growth=1.2, curriculum_reach_hardest=0.2,
    curriculum_reach_landing_rate=0.95, curriculum_window=20)


def begun(spawn_height: float = 200.0, **changes: Any) -> ReverseCurriculum:
    env = worlds.make('rocket', spawn_height=spawn_height)
    return ReverseCurriculum.begin(dataclasses.replace(CONFIG, **changes), env.spec)


def test_the_reach_begins_near_the_ground_without_a_rate() -> None:
    now = begun()
    assert (now.reach, now.full_reach, now.recent) == (0.4, pytest.approx(194.8), ())
    assert math.isnan(now.landing_rate) and not now.over
    assert now.reset_settings() == {'spawn_reach': 0.4}
    assert now.figures() == {'reach': 0.4}


def test_a_disabled_curriculum_is_over_from_the_start() -> None:
    """It has no settings and no figures, also in worlds without heights."""
    for name in ('rocket', 'lunar_lander'):
        now = ReverseCurriculum.begin(CurriculumConfig(), worlds.make(name).spec)
        assert now.over and now.reset_settings() == now.reset_settings(1) == now.figures() == {}
        assert now.advance([True] * 100) == now


def test_a_window_at_the_rate_grows_and_empties() -> None:
    grown = begun().advance([True] * 19 + [False])
    assert (grown.reach, grown.recent) == (0.4 * 1.2, ())
    for landed in ([True] * 19, [True] * 18 + [False] * 2):
        kept = begun().advance(landed)
        assert kept.reach == 0.4 and kept.recent == tuple(landed)
    assert begun().advance([False] * 100).advance([True] * 19).reach > 0.4


def test_the_reach_grows_to_the_whole_task_and_then_ends() -> None:
    """From 0.4 m by 1.2 to 194.8 m: 34 steps, ln(194.8 / 0.4) / ln 1.2 = 33.9; then one more."""
    now, reaches = begun(), []
    while not now.over:
        reaches.append(now.reach)
        now = now.advance([True] * 50)
    assert len(reaches) == 1 + math.ceil(math.log(194.8 / 0.4) / math.log(1.2)) == 35
    assert reaches[:-1] == pytest.approx([0.4 * 1.2**k for k in range(34)])
    assert reaches[-1] == now.full_reach
    assert now.reset_settings() == {} and now.figures() == {'reach': now.full_reach}
    # Of several groups every second one keeps all heights.
    assert [now.reset_settings(group) for group in range(3)] == [
        {}, {'spawn_reach': now.full_reach}, {}]
    assert now.advance([False] * 100) == now


def test_a_first_reach_beyond_the_drop_is_refused() -> None:
    with pytest.raises(ValueError, match=r'curriculum_start_reach: got 5, .*4\.8 m'):
        begun(10.0, curriculum_start_reach=5.0)


def test_a_reach_that_never_grows_is_for_the_whole_task() -> None:
    """Otherwise a run would never fly the task on which it is evaluated."""
    never = {'curriculum_reach_landing_rate': 2.0}
    with pytest.raises(ValueError, match=(
            r'^curriculum_reach_landing_rate: got 2, expected at most 1 with '
            r'curriculum_start_reach 194 below the full drop of the task, 194\.8 m$')):
        begun(curriculum_start_reach=194.0, **never)
    now = begun(curriculum_start_reach=194.79, **never)
    assert now.advance([True] * 100).reach == 194.79
    assert begun(curriculum_start_reach=0.0, **never).over
    one_level = {**never, 'curriculum_start_level': 7, 'curriculum_final_level': 7}
    assert make_config({**one_level, 'curriculum_start_reach': 194.8})
    assert make_config({**one_level, 'curriculum_final_level': 8})
    with pytest.raises(ValueError, match=(
            r'^curriculum_reach_landing_rate: got 2, expected at most 1, as levels rise only '
            r'after the reach: curriculum_start_level 7, curriculum_final_level 8$')):
        make_config({**one_level, 'curriculum_final_level': 8, 'curriculum_start_reach': 194.8})


def test_the_hardest_episodes_are_those_that_began_highest() -> None:
    """Of the first episodes of 256 rockets, they are those in the top fifth of heights."""
    env = worlds.make('rocket', 256)
    env.reset(seed=6, spawn_reach=3.0)
    height = env.position[1] - 5.2
    fall, ended = np.tile(np.float32([-1, 0, 0]), (256, 1)), []
    for step in range(50):
        ended.append((step, env.step(fall)[4]['episodes']))
    hardest = begun().hardest(ended, 6)
    assert [step for step, _ in hardest] == list(range(50))
    found = Episodes.concatenate([episodes for _, episodes in hardest])
    first = found.take(found.episode == 0)
    assert set(first.row) == set(np.flatnonzero(height > 0.8 * 3.0)) != set()
    assert (start_heights.reach_share(6, found.row, found.episode) > 0.8).all()
    everyone = Episodes.concatenate([e for _, e in begun(curriculum_reach_hardest=1.0).hardest(
        ended, 6)])
    assert len(everyone) == sum(len(episodes) for _, episodes in ended)
