# SPDX-License-Identifier: Apache-2.0
"""Worlds of a run's groups: the episodes by which the level is judged."""
from __future__ import annotations

import numpy as np
import pytest

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.ppo.rollout_buffer import Ended
from ppo_agent_node.training.group_worlds import GroupWorlds
from rocket_sim_node import worlds
from rocket_sim_node.worlds import Episodes

LANDED, TOO_FAST = 0, 1


def ended(step: int, rows: list[int], outcome: int) -> Ended:
    """Return episodes of some rows that ended with a step."""
    none = np.zeros(len(rows))
    return step, Episodes(
        np.array(rows), none.astype(np.int64), none, none.astype(np.int64) + step,
        np.full(len(rows), outcome, np.uint8), *([none] * 6), none.astype(np.int64), none)


def judged(flown: list[list[Ended]], **settings: object) -> Episodes:
    """Return the episodes of a roll-out by which the level is judged."""
    config = load_preset('default', 'rocket', **settings)
    return GroupWorlds(worlds.make('rocket', 8).spec, config, lambda jobs: iter(())).judged(flown)


def test_whole_episodes_are_not_ordered_by_their_ends() -> None:
    """An early crash is as recent as a landing, so the window shows each start equally often."""
    flown = [[ended(90, [2, 3, 6, 7], TOO_FAST), ended(400, [0, 1, 4, 5], LANDED)]]
    found = judged(flown, start_copies=4, num_groups=1, curriculum_wide_level=0)
    assert found.row.tolist() == [0, 4, 1, 5, 2, 6, 3, 7]
    assert found.outcome.tolist() == [LANDED] * 4 + [TOO_FAST] * 4


def test_other_episodes_are_ordered_by_their_ends() -> None:
    flown = [[ended(3, [5], LANDED)], [ended(2, [7], LANDED), ended(9, [1], TOO_FAST)]]
    found = judged(flown, start_copies=1, curriculum_wide_level=0)
    assert found.row.tolist() == [7, 5, 1]


@pytest.mark.parametrize('copies', [1, 4])
def test_the_wide_level_does_not_count(copies: int) -> None:
    plain, wide = [ended(4, [0], LANDED)], [ended(2, [1], TOO_FAST)]
    found = judged([plain, wide, plain, wide], start_copies=copies, num_groups=4)
    assert found.outcome.tolist() == [LANDED] * 2
