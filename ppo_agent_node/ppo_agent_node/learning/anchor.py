# SPDX-License-Identifier: Apache-2.0
"""An anchor in simulated time: work that a restart of the simulator undid is done again.

A roll-out is a transaction. It starts at a snapshot of the world and counts only when the next
snapshot has been taken. When the simulator comes back empty in between, the world is put back
into the snapshot and the work begins anew; as its random numbers are derived (see streams), the
second attempt is the first one, bit for bit.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import VectorEnv
from rocket_sim_node.worlds.base import F32

T = TypeVar('T')
MAX_ATTEMPTS = 20


class Anchor:
    """The last moment of the world that is certain, and the way back to it."""

    def __init__(self, env: VectorEnv, report: Callable[[str], None]) -> None:
        """Begin without a certain moment.

        :param report: is told of restarts.
        """
        self.env = env
        self.snapshot = b''
        self._report = report
        self._observation: F32 | None = None

    def cast(self, work: Callable[[], F32]) -> None:
        """Do work that is the same wherever the world is, such as a reset, and anchor after it.

        :param work: returns the observation `(N, D)`.
        """
        self._anchor(lambda: (work(), None))

    def advance(self, work: Callable[[F32], tuple[F32, T]]) -> T:
        """Do work that begins at the anchor, and anchor after it.

        :param work: takes the observation and returns the last one, and its result.
        """
        return self._anchor(lambda: work(self._return()))

    def excursion(self, work: Callable[[], T]) -> T:
        """Do work that is the same wherever the world is, and let the anchor be."""
        result = self._persist(work)
        self._observation = None
        return result

    def moor(self, snapshot: bytes) -> None:
        """Anchor at a snapshot that was saved earlier.

        :raises ValueError: when the world does not take it.
        """
        self.snapshot = snapshot
        self._observation = None
        self._persist(self._return)

    def _anchor(self, work: Callable[[], tuple[F32, T]]) -> T:
        def attempt() -> tuple[F32, T, bytes]:
            observation, result = work()
            return observation, result, self.env.snapshot()

        observation, result, snapshot = self._persist(attempt)
        self.snapshot, self._observation = snapshot, observation
        return result

    def _return(self) -> F32:
        """Return the observation at the anchor, having gone back there if need be."""
        if self._observation is None:
            self._observation = self.env.restore(self.snapshot)
        return self._observation

    def _persist(self, work: Callable[[], T]) -> T:
        for attempt in range(1, MAX_ATTEMPTS + 1):
            try:
                return work()
            except EnvironmentRestarted as error:
                self._observation = None
                self._report(f'simulator restarted, work begins again: {error}')
                if attempt == MAX_ATTEMPTS:
                    raise
        raise AssertionError('unreachable')
