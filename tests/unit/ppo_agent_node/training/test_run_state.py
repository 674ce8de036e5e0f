# SPDX-License-Identifier: Apache-2.0
"""The landing rate of a run, and the selections that wait for it."""
from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.training.curriculum import Curriculum
from ppo_agent_node.training.reverse_curriculum import ReverseCurriculum
from ppo_agent_node.training.run_state import RunState
from ppo_agent_node.training.selection import Selector
from rocket_sim_node import worlds

CONFIG = make_config({
    'curriculum_window': 4, 'curriculum_final_level': 2, 'curriculum_start_reach': 100.0,
    'curriculum_reach_growth': 10.0, 'selection_from_landing_rate': 0.5, 'selection_interval': 1})


def due(now: RunState, before: RunState) -> bool:
    unused: Any = SimpleNamespace()
    return Selector(unused, CONFIG, unused, unused).due(
        1, now.landing_rate, harder=bool(now.news(before)))


def test_selections_wait_for_a_full_window_or_a_harder_task() -> None:
    levels = CONFIG.curriculum
    state = RunState(
        Curriculum.begin(levels), ReverseCurriculum.begin(levels, worlds.make('rocket').spec))
    news = []
    while len(news) < 3:
        for landed in ([], [True], [True, True]):  # 0, 1 and 3 episodes of 4
            before, state = state, state.advance(landed, landed)
            assert math.isnan(state.landing_rate) and not due(state, before)
        before, state = state, state.advance([False], [False])
        assert state.landing_rate == 0.75 and due(state, before)
        worse = state.advance([False] * 2, [False] * 2)
        assert worse.landing_rate == 0.25 and not due(worse, state)
        before, state = state, state.advance([True] * 4, [True] * 4)
        assert math.isnan(state.landing_rate) and due(state, before)
        news.append(state.news(before))
    assert news == ['reach 100.00 -> 194.80 m', 'the whole task, level 1', 'level 1 -> 2']
    for _ in range(2):  # nothing becomes harder any more
        before, state = state, state.advance([True] * 4, [])
        assert (state.landing_rate, state.news(before)) == (1.0, '') and due(state, before)


@pytest.mark.parametrize('iteration', [1, 2])
def test_without_a_rate_selections_follow_their_interval(iteration: int) -> None:
    unused: Any = SimpleNamespace()
    selector = Selector(unused, make_config({'selection_interval': 2}), unused, unused)
    assert selector.due(iteration, math.nan, harder=False) == (iteration == 2)
