# SPDX-License-Identifier: Apache-2.0
"""Fleet of all ranks: each flies its part of the jobs, and all receive all results."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from typing import TypeVar

from ppo_agent_node.distributed.ranks import Ranks
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.jobs import Fleet
from rocket_sim_node.worlds.jobs import Job

T = TypeVar('T')


class RankedFleet:
    """A `Fleet` of which each rank has a part.

    Job number j runs on rank j modulo the number of ranks. All ranks must ask for the same jobs.
    """

    def __init__(self, fleet: Fleet, ranks: Ranks) -> None:
        """Wrap this rank's part."""
        self._fleet, self._ranks = fleet, ranks

    @property
    def spec(self) -> WorldSpec:
        """The shape of each environment's world."""
        return self._fleet.spec

    @property
    def messages_dropped(self) -> int:
        """Number of messages that this rank's part has ignored."""
        return self._fleet.messages_dropped

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Run this rank's jobs, and yield the results of all ranks in order; see `Fleet`.

        :raises RankLost: when another rank is gone.
        """
        index, count = self._ranks.index, self._ranks.count
        mine = list(self._fleet.fly(flights[index::count], poll, report))
        parts = self._ranks.main.gather(mine, poll)
        for number in range(len(flights)):
            yield parts[number % count][number // count]
