# SPDX-License-Identifier: Apache-2.0
"""Fleet of simulators that run jobs for one agent and may join, leave or fail at any time.

Each simulator runs its own job, so simulators and agent work in parallel: while the agent computes
for one, the others step. A job's result does not depend on which simulator runs it or how often
it was restarted, and results are returned in job order. The number of simulators therefore only
affects the run time.
"""
from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from typing import Any
from typing import TypeVar

from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.errors import EnvironmentRestarted
from rocket_sim_node.wire.client.client import RELEASE_TIMEOUT
from rocket_sim_node.wire.client.client import await_any
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.client.connection import WorldChanged
from rocket_sim_node.wire.client.membership import FleetMembership
from rocket_sim_node.wire.client.worker import FleetWorker
from rocket_sim_node.wire.client.worker import Task
from rocket_sim_node.wire.messages.definitions import DefinitionsDiffer
from rocket_sim_node.wire.node.waiting import Silence
from rocket_sim_node.wire.node.waiting import Waiter
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import MAX_ATTEMPTS
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import check_last

T = TypeVar('T')
_OTHER = (WorldChanged, DefinitionsDiffer)
"""Errors that exclude a simulator from the fleet."""
_IDLE_PERIOD = 0.1
"""Seconds between checks for a usable simulator."""
_SILENT = 2.0
"""Seconds without an answer before a job is moved to an idle simulator; increased with each
attempt, because a step may simply take long."""
_BUSY = 0.1
"""Seconds of computing after which the silence timer restarts: no messages were read meanwhile."""


class SimulatorFleet:
    """Simulators as a `worlds.jobs.Fleet`. It alone spins `executor` while it waits."""

    def __init__(
        self, node: Node, executor: Executor, options: ConnectionOptions, agent: int,
        pattern: str = '', second: str = '',
    ) -> None:
        """Connect to simulators.

        :param agent: identity, 1 to 2**64 - 1.
        :param pattern: namespaces, such as `/sim_*`, of the simulators to use; every match is
            added when it appears. Empty: the simulator in the node's own namespace.
        :param second: namespace, below the node's own, of a second simulator to use when it
            appears; only with an empty pattern.
        :raises ValueError: when the pattern or `second` is not a valid namespace.
        """
        self._node = node
        self._membership = FleetMembership(node, options, agent, pattern, second)
        self._waiter = Waiter(node, executor, options.patience)
        self._idle: Silence | None = None
        """Time-out that runs while no simulator has a job; None otherwise."""
        self._idle_look = math.inf
        """Steady-clock time, s, of the next check."""
        self._listening_since = 0.0
        """Steady-clock time, s, of the end of the jobs' last long computation."""

    def __enter__(self) -> SimulatorFleet:
        """Use as a context that releases the simulators on exit."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the simulators."""
        self.close()

    @property
    def spec(self) -> WorldSpec:
        """The shape of each simulator's world; the first access waits for one.

        :raises WireTimeout: when none appears.
        """
        return self._membership.spec or self.connect()

    @property
    def realtime(self) -> bool:
        """Whether any simulator runs in real time."""
        return any(worker.connection.realtime for worker in self._membership)

    @property
    def messages_dropped(self) -> int:
        """Messages ignored because they did not come from the simulators."""
        return self._membership.messages_dropped

    def connect(self) -> WorldSpec:
        """Wait for the first simulator and return the shape of its world.

        :raises WireTimeout: when none appears.
        """
        def found() -> bool:
            self._membership.look()
            return self._membership.has_free_worker

        self._waiter.wait(found, 'a description', self._membership.where)
        assert self._membership.spec is not None
        return self._membership.spec

    # Running jobs

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Run all jobs and yield their results in order; see `worlds.jobs.Fleet`.

        :raises WireTimeout: when no simulator is available, or none answers.
        :raises SimulatorBusy: when another agent controls all of them.
        """
        waiting = deque(Task(number, begin) for number, begin in enumerate(flights))
        results: dict[int, T] = {}
        due = 0
        try:
            while due < len(flights):
                poll()
                self._membership.look()
                self._assign(waiting, results)
                ready = self._wait()
                begun = time.monotonic()
                for worker in ready:
                    self._attend(worker, waiting, results, report)
                if time.monotonic() - begun > _BUSY:
                    self._listening_since = time.monotonic()
                if not waiting:
                    self._relieve(waiting, report)
                while due in results:
                    yield results.pop(due)
                    due += 1
        finally:
            for worker in self._membership:
                if worker.task is not None:
                    worker.task.flight.close()
                    worker.drop()
            for task in waiting:
                task.flight.close()

    def _assign(self, waiting: deque[Task[T]], results: dict[int, T]) -> None:
        """Assign jobs to free simulators, first those whose snapshot is already restored there."""
        free = [worker for worker in self._membership if worker.free]
        for worker in free:
            for task in waiting:
                if isinstance(task.command, Restore) and (
                        task.command.state == worker.last_snapshot.state):
                    waiting.remove(task)
                    self._start(worker, task, results)
                    break
        for worker in free:
            if waiting and worker.free:
                self._start(worker, waiting.popleft(), results)

    def _relieve(self, waiting: deque[Task[T]], report: Callable[[str], None]) -> None:
        """Move a job from an unresponsive simulator when another one is free."""
        if not self._membership.has_free_worker:
            return
        now = time.monotonic()
        for worker in self._membership:
            if worker.task is None:
                continue
            patience = _SILENT * worker.task.attempts
            silence = min(worker.connection.waited(now), now - self._listening_since)
            if worker.gone or silence > patience:
                why = 'gone' if worker.gone else f'silent for {patience:g} s'
                self._lose(worker, waiting, why, report)
                return

    def _lose(
        self, worker: FleetWorker, waiting: deque[
            Task[T]], why: str, report: Callable[[str], None],
    ) -> None:
        """Take back a worker's job and ignore the worker until it is heard from again."""
        report(f'{worker.connection.name}: {why}; its job starts again')
        self._give_back(worker, waiting)
        worker.connection.let_go()
        worker.lost_at = time.monotonic()

    @staticmethod
    def _give_back(worker: FleetWorker, waiting: deque[Task[T]]) -> None:
        """Put a worker's job at the head of the queue, restarted."""
        task = worker.task
        assert task is not None
        worker.drop()
        task.flight.close()
        task.begin()
        waiting.appendleft(task)

    def _start(self, worker: FleetWorker, task: Task[T], results: dict[int, T]) -> None:
        worker.task = task
        self._go_on(worker, worker.last_snapshot.answer(task.command), results)

    def _go_on(self, worker: FleetWorker, answer: Any, results: dict[int, T]) -> None:
        """Send a job its answer, if there is one, and issue its next command."""
        task = worker.task
        assert task is not None
        try:
            while answer is not None:
                task.command = task.flight.send(answer)
                answer = worker.last_snapshot.answer(task.command)
        except StopIteration as end:
            check_last(task.command)
            results[task.number] = end.value
            worker.task = None
            return
        worker.connection.ask(task.command)

    def _attend(
        self, worker: FleetWorker, waiting: deque[Task[T]], results: dict[int, T],
        report: Callable[[str], None],
    ) -> None:
        """Check whether an answer has arrived, and continue the job with it."""
        task, connection = worker.task, worker.connection
        assert task is not None
        try:
            if not connection.poll():
                return
            answer = connection.take()
        except EnvironmentRestarted as error:
            report(f'simulator restarted; its job starts again: {error}')
            if task.attempts >= MAX_ATTEMPTS:
                raise
            self._give_back(worker, waiting)
        except (WireTimeout, SimulatorBusy, *_OTHER) as error:
            if not any(other.free or other.task for other in self._membership
                       if other is not worker):
                raise
            self._lose(worker, waiting, str(error), report)
            if isinstance(error, _OTHER):
                worker.fits = False
                self._node.get_logger().error(f'{error}; it is no longer used')
        else:
            worker.last_snapshot.note(task.command, answer)
            self._go_on(worker, answer, results)

    def _wait(self) -> list[FleetWorker]:
        """Return the workers that may need attention, once there are any.

        :raises WireTimeout: when no worker has a job for longer than the patience.
        """
        busy = [worker for worker in self._membership if worker.task is not None]
        if not busy:
            self._idle = self._idle or Silence(
                self._node, 'an answer', self._waiter.patience, self._membership.where)
            self._idle.check(self._idle_look)
            self._idle_look = time.monotonic() + _IDLE_PERIOD
            self._waiter.spin(_IDLE_PERIOD)
            return []
        self._idle, self._idle_look = None, math.inf
        if not self._waiter.overdue and (ready := [m for m in busy if m.connection.arrived]):
            return ready  # answers arrived while the agent computed: no need to wait
        full, others = await_any(self._waiter, [worker.connection for worker in busy])
        if others:
            return busy
        return [worker for worker in busy if worker.connection.awaited in full]

    def keep(self) -> None:
        """Send keep-alives to the simulators while the agent computes; call it often."""
        for worker in self._membership:
            worker.connection.keep()

    def close(self) -> None:
        """Release the simulators for another agent, and close their connections.

        The fleet cannot be used afterwards.
        """
        farewells = [worker.connection.release() for worker in self._membership]
        self._waiter.linger(lambda: all(done() for done in farewells), RELEASE_TIMEOUT)
        self._membership.close()
