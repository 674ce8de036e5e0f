# SPDX-License-Identifier: Apache-2.0
"""Lines and averages of training episodes."""
from __future__ import annotations

import numpy as np
import pytest

from ppo_agent_node.runs.episode_scores import ScoreLines
from ppo_agent_node.runs.episode_scores import figures
from ppo_agent_node.runs.episode_scores import moving_average
from ppo_agent_node.statistics import wilson
from rocket_sim_node.worlds import Episodes


def test_lines_are_those_of_the_original() -> None:
    lines = ScoreLines(10_000)
    for score in (-200.0, -230.0, -190.0, -180.0, -210.0, -263.4):
        lines.add([score])
    assert lines.add([-106.96]) == ['episode: 7/10000, score: -107.0, average: -197.2']


def test_averages_are_of_the_last_fifty() -> None:
    lines = ScoreLines(0).add([1000.0, *range(49), 50.0])
    assert lines[0] == 'episode: 1, score: 1000.0, average: 1000.0'
    assert lines[1] == 'episode: 2, score: 0.0, average: 500.0'
    assert lines[49] == f'episode: 50, score: 48.0, average: {(1000 + 48 * 49 / 2) / 50:.1f}'
    assert lines[50] == f'episode: 51, score: 50.0, average: {(50 + 48 * 49 / 2) / 50:.1f}'


def test_moving_average() -> None:
    scores = np.random.default_rng(1).normal(-50, 100, 173)
    naive = [scores[max(0, end - 50):end].mean() for end in range(1, 174)]
    assert moving_average(scores) == pytest.approx(naive, abs=1e-9)
    assert len(moving_average(np.zeros(0))) == 0


def test_the_interval_counts_the_copies_of_a_start_as_one_episode() -> None:
    none, whole = np.zeros(64), np.zeros(64, np.int64)
    outcome = np.repeat(np.array([0, 1], np.uint8), (48, 16))
    episodes = Episodes(
        whole, whole, none, whole, outcome, *([none] * 6), ignitions=whole, control_effort=none)
    alone, alike = (figures(episodes, ('landed', 'crashed'), copies) for copies in (1, 16))
    assert alone['landing_rate'] == alike['landing_rate'] == 0.75
    assert (alone['landing_rate_low'], alone['landing_rate_high']) == wilson(48, 64)
    assert (alike['landing_rate_low'], alike['landing_rate_high']) == wilson(3, 4)
