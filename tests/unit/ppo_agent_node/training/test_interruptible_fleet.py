# SPDX-License-Identifier: Apache-2.0
"""Flights of a training run, shared by its ranks."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ppo_agent_node.distributed.ranks import Channel
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.training.interruptible_fleet import InterruptibleFleet
from rocket_sim_node import worlds
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import SerialFleet


class OneOfThree(Channel):
    """The channel of rank 1; the fleets of ranks 0 and 2 have dropped messages, too."""

    def gather(self, value: Any, poll: Callable[[], None] = lambda: None) -> list[Any]:
        return [(['first'], 5), value, (['third'], 7)]


def test_dropped_messages_are_those_of_all_ranks() -> None:
    world = worlds.make('rocket', num_envs=1)
    world.messages_dropped = 2  # type: ignore[attr-defined]

    def fly() -> Job[str]:
        yield from ()
        return 'second'

    fleet = InterruptibleFleet(
        SerialFleet(world), Ranks(1, 3, OneOfThree(1, 3)), lambda: False, pytest.fail)
    assert fleet.messages_dropped == 2
    assert list(fleet.fly([fly] * 3)) == ['first', 'second', 'third']
    world.messages_dropped = 3  # type: ignore[attr-defined]
    assert fleet.messages_dropped == 5 + 3 + 7
