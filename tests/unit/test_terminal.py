# SPDX-License-Identifier: Apache-2.0
"""What a person sees of a run."""
from __future__ import annotations

import io

from ppo_agent_node.learning.status import Status
from ppo_agent_node.terminal import Terminal
from ppo_agent_node.terminal import describe

STATUS = Status(
    stage='finetune', iteration=3, iterations=50, level=4, landing_rate=0.9876, mean_return=281.26,
    steps_per_second=123456.7, elapsed=61.0, remaining=125.0, message='level 4 -> 5')


def test_what_is_not_known_is_left_out() -> None:
    assert describe(Status(stage='finetune')) == ''
    assert describe(STATUS) == (
        'level 4, landed 98.8%, return 281.3, 123,457 steps/s, 2:05 left')


def test_a_log_gets_one_plain_line_a_report() -> None:
    file = io.StringIO()
    with Terminal(file) as terminal:
        terminal.show(STATUS)
        terminal.say('[not] markup')
    assert file.getvalue().splitlines() == [
        '[1:01] PPO 3/50: level 4, landed 98.8%, return 281.3, 123,457 steps/s, 2:05 left; '
        'level 4 -> 5',
        '[not] markup',
    ]
