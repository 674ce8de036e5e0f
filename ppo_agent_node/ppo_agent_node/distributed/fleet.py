# SPDX-License-Identifier: Apache-2.0
"""Flights of all ranks: each flies its part of the jobs, and all receive all results."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from typing import TypeVar

from ppo_agent_node.distributed.ranks import Ranks
from rocket_sim_node.worlds.jobs import Fleet
from rocket_sim_node.worlds.jobs import Job

T = TypeVar('T')


def fly_together(
    fleet: Fleet, ranks: Ranks, flights: Sequence[Callable[[], Job[T]]],
    poll: Callable[[], None], report: Callable[[str], None], dropped: Callable[[int], None],
) -> Iterator[T]:
    """Run this rank's jobs in its fleet, and yield the results of all ranks in order.

    Job number j runs on rank j modulo the number of ranks. All ranks must ask for the same jobs.
    The other parameters are those of `Fleet.fly`.

    :param dropped: called with the number of messages that the fleets of the others have dropped.
    :raises RankLost: when another rank is gone.
    """
    if ranks.count == 1:
        yield from fleet.fly(flights, poll, report)
        return
    mine = list(fleet.fly(flights[ranks.index::ranks.count], poll, report))
    parts, counts = zip(
        *ranks.main.gather((mine, fleet.messages_dropped), poll), strict=True)
    dropped(sum(counts) - counts[ranks.index])
    for number in range(len(flights)):
        yield parts[number % ranks.count][number // ranks.count]
