# SPDX-License-Identifier: Apache-2.0
"""A simulator of a fleet, and the job that it runs."""
from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any
from typing import Generic
from typing import TypeVar

from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.worlds.jobs import Command
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import LastSnapshot

T = TypeVar('T')
_RETRY = 10.0
"""Seconds before a lost simulator is tried again even if nothing was heard from it."""


class Task(Generic[T]):
    """A job and the number of times it was started."""

    def __init__(self, number: int, begin: Callable[[], Job[T]]) -> None:
        self.number, self._begin, self.attempts = number, begin, 0
        self.begin()

    def begin(self) -> None:
        """Start the job from the beginning."""
        self.attempts += 1
        self.flight = self._begin()
        self.command: Command = next(self.flight)


class FleetWorker:
    """A simulator's connection, its restored snapshot and its current job."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.last_snapshot = LastSnapshot()
        self.task: Task[Any] | None = None
        self.lost_at = 0.0
        self.vetted: Any = None
        """The description that was checked last."""
        self.fits = self.gone = False

    @property
    def free(self) -> bool:
        """Whether it can take a job: it matches, is idle, and was heard from since it was lost."""
        return self.task is None and self.fits and not self.gone and (
            self.connection.heard >= self.lost_at or time.monotonic() - self.lost_at > _RETRY)

    def drop(self) -> None:
        """Forget its job and its snapshot."""
        self.connection.drop()
        self.last_snapshot.forget()
        self.task = None
