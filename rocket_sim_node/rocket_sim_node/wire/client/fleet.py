# SPDX-License-Identifier: Apache-2.0
"""Simulators, one or many, that fly for one agent; they may join, leave and die while they do.

Each flies a flight of its own, so that all of them and the agent work at once: while the agent
thinks about one, the others move. What a flight comes to does not depend on who flies it, nor on
how often it was begun, and results come in the order of the flights: the number of simulators
decides how long it takes and nothing else.
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
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.client.connection import WorldChanged
from rocket_sim_node.wire.client.membership import FleetMembership
from rocket_sim_node.wire.client.worker import FleetWorker
from rocket_sim_node.wire.client.worker import Task
from rocket_sim_node.wire.messages.definitions import DefinitionsDiffer
from rocket_sim_node.wire.node.inbox import Mailbox
from rocket_sim_node.wire.node.waiting import Silence
from rocket_sim_node.wire.node.waiting import Waiter
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import MAX_ATTEMPTS
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Restore

T = TypeVar('T')
_OTHER = (WorldChanged, DefinitionsDiffer)
"""why a simulator is not one of the fleet"""
_IDLE_PERIOD = 0.1
"""s between two looks for somebody who flies"""
_SILENT = 2.0
"""s without an answer after which a flight is given to a simulator that has nothing to do; more
each time, as a step may just take long"""


class SimulatorFleet:
    """Simulators as a `worlds.flight.Fleet`. It spins `executor` while it waits, nobody else."""

    def __init__(
        self, node: Node, executor: Executor, options: ConnectionOptions, agent: int,
        pattern: str = '',
    ) -> None:
        """Advertise.

        :param agent: identity, 1 to 2**64 - 1.
        :param pattern: namespaces, such as `/sim_*`, of the simulators that may fly: whatever
            matches is taken in when it appears. Empty: the one of the node's own namespace.
        :raises ValueError: when the pattern is no namespace.
        """
        self._node = node
        self._roster = FleetMembership(node, options, agent, pattern)
        self._waiter = Waiter(node, executor, options.patience)
        self._idle: Silence | None = None
        """since nobody flies"""
        self._idle_look = math.inf
        """when it is looked at next, s of the steady clock"""

    def __enter__(self) -> SimulatorFleet:
        """Use as a context that lets go of the simulators at the end."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go."""
        self.close()

    @property
    def spec(self) -> WorldSpec:
        """The shape that the world of each has; waits for the first of them.

        :raises WireTimeout: when none shows up.
        """
        return self._roster.spec or self.connect()

    @property
    def realtime(self) -> bool:
        """Whether a simulator goes by the clock."""
        return any(member.link.realtime for member in self._roster)

    def connect(self) -> WorldSpec:
        """Wait for the first simulator and return what it is.

        :raises WireTimeout: when none shows up.
        """
        def found() -> bool:
            self._roster.look()
            return self._roster.anybody_free

        self._waiter.wait(found, 'a description', self._roster.where)
        assert self._roster.spec is not None
        return self._roster.spec

    # Flying

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Fly them all and yield their results, in order; see `worlds.flight.Fleet`.

        :raises WireTimeout: when nobody is there to fly, or answers.
        :raises SimulatorBusy: when another agent keeps them all.
        """
        waiting = deque(Task(number, begin) for number, begin in enumerate(flights))
        results: dict[int, T] = {}
        due = 0
        try:
            while due < len(flights):
                poll()
                self._roster.look()
                self._assign(waiting, results)
                for member in self._wait():
                    self._attend(member, waiting, results, report)
                if not waiting:
                    self._relieve(waiting, report)
                while due in results:
                    yield results.pop(due)
                    due += 1
        finally:
            for member in self._roster:
                if member.task is not None:
                    member.task.flight.close()
                    member.drop()
            for task in waiting:
                task.flight.close()

    def _assign(self, waiting: deque[Task[T]], results: dict[int, T]) -> None:
        """Give flights to those that have none: first to whom they would begin where it is."""
        free = [member for member in self._roster if member.free]
        for member in free:
            for task in waiting:
                if isinstance(task.command, Restore) and (
                        task.command.state == member.mooring.state):
                    waiting.remove(task)
                    self._start(member, task, results)
                    break
        for member in free:
            if waiting and member.free:
                self._start(member, waiting.popleft(), results)

    def _relieve(self, waiting: deque[Task[T]], report: Callable[[str], None]) -> None:
        """Take a flight from whom nothing is heard of, when somebody else is free to fly it."""
        if not self._roster.anybody_free:
            return
        now = time.monotonic()
        for member in self._roster:
            if member.task is None:
                continue
            patience = _SILENT * member.task.attempts
            if member.gone or member.link.waited(now) > patience:
                why = 'gone' if member.gone else f'silent for {patience:g} s'
                self._lose(member, waiting, why, report)
                return

    def _lose(
        self, member: FleetWorker, waiting: deque[
            Task[T]], why: str, report: Callable[[str], None],
    ) -> None:
        """Give a member's flight back, and expect nothing of it before it is heard again."""
        report(f'{member.link.name}: {why}; its flight begins anew')
        self._give_back(member, waiting)
        member.link.let_go()
        member.lost_at = time.monotonic()

    @staticmethod
    def _give_back(member: FleetWorker, waiting: deque[Task[T]]) -> None:
        """Put a member's flight before the others that wait, to begin anew."""
        task = member.task
        assert task is not None
        member.drop()
        task.flight.close()
        task.begin()
        waiting.appendleft(task)

    def _start(self, member: FleetWorker, task: Task[T], results: dict[int, T]) -> None:
        member.task = task
        self._go_on(member, member.mooring.answer(task.command), results)

    def _go_on(self, member: FleetWorker, answer: Any, results: dict[int, T]) -> None:
        """Hand a flight its answer, if there is one, and ask for what it wants next."""
        task = member.task
        assert task is not None
        try:
            while answer is not None:
                task.command = task.flight.send(answer)
                answer = member.mooring.answer(task.command)
        except StopIteration as end:
            results[task.number] = end.value
            member.task = None
            return
        member.link.ask(task.command)

    def _attend(
        self, member: FleetWorker, waiting: deque[Task[T]], results: dict[int, T],
        report: Callable[[str], None],
    ) -> None:
        """See whether an answer has come, and go on with it."""
        task, link = member.task, member.link
        assert task is not None
        try:
            if not link.poll():
                return
            answer = link.take()
        except EnvironmentRestarted as error:
            report(f'simulator restarted, work begins again: {error}')
            if task.attempts >= MAX_ATTEMPTS:
                raise
            self._give_back(member, waiting)
        except (WireTimeout, SimulatorBusy, *_OTHER) as error:
            if not any(other.free or other.task for other in self._roster
                       if other is not member):
                raise
            self._lose(member, waiting, str(error), report)
            if isinstance(error, _OTHER):
                member.fits = False
                self._node.get_logger().error(f'{error}; it is not flown any more')
        else:
            member.mooring.note(task.command, answer)
            self._go_on(member, answer, results)

    def _wait(self) -> list[FleetWorker]:
        """Return the members that may have to be attended to, once there are some.

        :raises WireTimeout: when nobody flies, for longer than the patience.
        """
        busy = [member for member in self._roster if member.task is not None]
        if not busy:
            self._idle = self._idle or Silence(
                self._node, 'somebody who flies', self._waiter.patience, self._roster.where)
            self._idle.check(self._idle_look)
            self._idle_look = time.monotonic() + _IDLE_PERIOD
            self._waiter.spin(_IDLE_PERIOD)
            return []
        self._idle, self._idle_look = None, math.inf
        if not self._waiter.overdue and (ready := [m for m in busy if m.link.arrived]):
            return ready  # while one was thought about, others have answered: no need to wait
        mailboxes: list[Mailbox] = []
        entities: dict[str, list[Any]] = {'subscriptions': [], 'clients': []}
        for member in busy:
            mailbox = member.link.mailbox
            if mailbox is not None:
                mailboxes.append(mailbox)
                continue
            for kind, found in member.link.entities.items():
                entities[kind] += found
        due = min(member.link.deadline for member in busy)
        full, others = self._waiter.attend(due - time.monotonic(), mailboxes, **entities)
        if others or time.monotonic() >= due:
            return busy
        return [member for member in busy if member.link.mailbox in full]

    def keep(self) -> None:
        """Remind the simulators of their agent while that one computes; call it often."""
        for member in self._roster:
            member.link.keep()

    def close(self) -> None:
        """Let go of the simulators, so that another agent need not wait, and of their topics.

        It cannot be flown with after that.
        """
        farewells = [member.link.release() for member in self._roster]
        self._waiter.linger(lambda: all(done() for done in farewells), RELEASE_TIMEOUT)
        self._roster.close()
