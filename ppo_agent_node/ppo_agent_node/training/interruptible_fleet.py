# SPDX-License-Identifier: Apache-2.0
"""Wrapper of a fleet that runs jobs until the training run is asked to stop."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from typing import TypeVar

from ppo_agent_node.distributed.fleet import fly_together
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.threads import tensor_threads
from rocket_sim_node import free_memory
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds.jobs import Fleet
from rocket_sim_node.worlds.jobs import Job

T = TypeVar('T')


class InterruptibleFleet:
    """Runs the jobs of a training run, and checks for a stop request."""

    def __init__(
        self, fleet: Fleet, ranks: Ranks, stop_requested: Callable[[], bool],
        report: Callable[[str], None],
    ) -> None:
        """Wrap the fleet.

        :param ranks: those that run the jobs together, each in a fleet of its own.
        :param stop_requested: called before each step and each minibatch.
        :param report: called with a text when a job is restarted.
        """
        self._fleet, self._ranks = fleet, ranks
        self._stop_requested, self._report = stop_requested, report
        self._dropped_elsewhere = 0
        self._give_back = free_memory.PeriodicTrim()

    def fly(self, flights: Sequence[Callable[[], Job[T]]]) -> Iterator[T]:
        """Run jobs, and yield their results in order.

        :raises EnvironmentClosed: when the run is asked to stop.
        """
        with tensor_threads(1):
            yield from fly_together(
                self._fleet, self._ranks, flights, self.poll, self._report, self._note_dropped)

    @property
    def messages_dropped(self) -> int:
        """Messages dropped by the fleets of all ranks; of the others, up to a flight's end."""
        return self._fleet.messages_dropped + self._dropped_elsewhere

    def _note_dropped(self, count: int) -> None:
        self._dropped_elsewhere = count

    def poll(self) -> None:
        """Check for a stop request.

        :raises EnvironmentClosed: when the run is asked to stop.
        """
        if self._stop_requested():
            raise EnvironmentClosed('asked to stop')

    def poll_learning(self) -> None:
        """Check for a stop request between minibatches, and return free memory periodically."""
        # Here, while most memory of an update is in use: returned between two updates, it would
        # only be requested again, and memory use would fluctuate.
        self._give_back()
        self.poll()
