# SPDX-License-Identifier: Apache-2.0
"""The crew of a run: a fleet of simulators that flies until the run is asked to stop."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from typing import TypeVar

from ppo_agent_node.threads import tensor_threads
from rocket_sim_node import free_memory
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds.jobs import Fleet
from rocket_sim_node.worlds.jobs import Job

T = TypeVar('T')


class InterruptibleFleet:
    """Flies what a run needs flown, and hears whether it shall stop."""

    def __init__(
        self, fleet: Fleet, stop_requested: Callable[[], bool], report: Callable[[str], None],
    ) -> None:
        """Take the fleet.

        :param stop_requested: asked before each step and each minibatch.
        :param report: is told of flights that were begun anew.
        """
        self._fleet, self._stop_requested, self._report = fleet, stop_requested, report
        self._give_back = free_memory.PeriodicTrim()

    def fly(self, flights: Sequence[Callable[[], Job[T]]]) -> Iterator[T]:
        """Fly, and yield the results in the order of the flights.

        :raises EnvironmentClosed: when the run is asked to stop.
        """
        with tensor_threads(1):
            yield from self._fleet.fly(flights, self.poll, self._report)

    def poll(self) -> None:
        """Look whether the run shall stop.

        :raises EnvironmentClosed: when it is asked to.
        """
        if self._stop_requested():
            raise EnvironmentClosed('asked to stop')

    def poll_learning(self) -> None:
        """Do the same between two minibatches, and give back memory now and then."""
        # While most of what an update works with is in use: given back between two updates, it
        # would only be asked for again, and memory go up and down.
        self._give_back()
        self.poll()
