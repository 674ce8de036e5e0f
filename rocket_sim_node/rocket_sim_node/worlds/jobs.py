# SPDX-License-Identifier: Apache-2.0
"""Jobs: units of work with a simulator, written as generators so that many can run in parallel.

A job yields commands, receives the environment's answers, and returns its result:

>>> def drop(seed: int) -> Job[float]:
...     observation = yield Reset(seed)
...     observation, reward, terminated, truncated, info = yield engine_off
...     return float(reward.sum())

It begins with `Reset` or `Restore`, so it does not matter where it runs or how often it was
started: a fleet may run it on any simulator, and again when a simulator was lost.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Generator
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from typing import Any
from typing import Protocol
from typing import TypeVar
from typing import cast

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.errors import EnvironmentRestarted
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import VectorEnv
from rocket_sim_node.worlds.base import WorldSpec

T = TypeVar('T')
MAX_ATTEMPTS = 20
"""Number of attempts at a job before its restarts are treated as a fault."""


@dataclass(frozen=True)
class Reset:
    """Start new episodes; answered with the observation `(N, D)`, as `VectorEnv.reset` is."""

    seed: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Restore:
    """Restore a snapshot; answered with the observation `(N, D)`."""

    state: bytes


@dataclass(frozen=True)
class Snapshot:
    """Take a snapshot of the exact state; answered with bytes."""


Results = tuple[F32, Bools, Bools, dict[str, Any]]
"""What an action led to: the return value of `VectorEnv.step` less the observation."""


@dataclass(frozen=True)
class Act:
    """Take a step; answered with the observation `(N, D)` alone, the results follow.

    Over DDS, the next action is sent before the results of this one are recorded, so that this
    takes no time of its own. Another command must follow: it is sent when they have arrived.
    """

    action: NDArray[Any]
    record: Callable[[Results], None]
    """Called with the results before the next command is answered; not if the job is lost."""


Command = Reset | Restore | Snapshot | Act | NDArray[Any]
"""The commands that a job may yield. An array is an action, answered as by `VectorEnv.step`."""
Job = Generator[Command, Any, T]


class Fleet(Protocol):
    """One or more environments of the same kind that run jobs."""

    @property
    def spec(self) -> WorldSpec:
        """The shape of each environment's world."""
        ...

    @property
    def messages_dropped(self) -> int:
        """Number of messages ignored so far because they came from other participants."""
        ...

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Run all jobs and yield their results in order.

        :param flights: functions that start a job each time they are called.
        :param poll: called before each step; an exception it raises ends all jobs.
        :param report: called with a text when a job is restarted.
        :raises EnvironmentRestarted: when a job was lost too often.
        """
        ...


class LastSnapshot:
    """The snapshot that an environment is at, to skip a redundant restore.

    Most roll-outs begin where the last one ended, so their restore would change nothing.
    """

    def __init__(self) -> None:
        """Start with an unknown state."""
        self.state: bytes | None = None
        self._observation: F32 | None = None

    def note(self, command: Command, answer: Any) -> None:
        """Record an executed command."""
        if isinstance(command, Snapshot):
            self.state = answer
            return
        self.state = None
        self._observation = answer[0] if isinstance(command, np.ndarray) else answer

    def forget(self) -> None:
        """Forget the environment's state."""
        self.state = self._observation = None

    def answer(self, command: Command) -> F32 | None:
        """Return the answer of a command that would change nothing; None if it must be executed.

        The results are identical either way, bit for bit.
        """
        if isinstance(command, Restore) and self.state == command.state:
            self.state = None
            return self._observation
        return None


def no_command(found: object) -> TypeError:
    """Return the error for an object that is not a command."""
    return TypeError(
        f'job: got {type(found).__name__}, expected Reset, Restore, Snapshot, Act or an array')


def check_last(command: Command | None) -> None:
    """Check the last command of a job, None if it yielded none.

    :raises TypeError: when it leaves results to be recorded.
    """
    if isinstance(command, Act):
        raise TypeError('job: ended after Act, expected another command to follow it')


def execute(env: VectorEnv, command: Command) -> Any:
    """Execute a job's command in an environment; return the answer.

    :raises TypeError: for an object that is not a command.
    """
    if isinstance(command, np.ndarray):
        return env.step(command)
    if isinstance(command, Act):
        observation, *results = env.step(command.action)
        command.record(cast(Results, tuple(results)))
        return observation
    if isinstance(command, Reset):
        return env.reset(command.seed, **command.settings)
    if isinstance(command, Restore):
        return env.restore(command.state)
    if isinstance(command, Snapshot):
        return env.snapshot()
    raise no_command(command)


def fly(
    env: VectorEnv, flight: Job[T], poll: Callable[[], None] = lambda: None,
    last: LastSnapshot | None = None,
) -> T:
    """Run one job and return its result.

    :param poll: called before each step; may raise.
    :param last: the environment's last snapshot, if known.
    :raises EnvironmentRestarted: when the job's progress is lost.
    """
    last = last or LastSnapshot()
    command: Command | None = None
    answer: Any = None
    try:
        while True:
            command = flight.send(answer)
            answer = last.answer(command)
            if answer is None:
                poll()
                answer = execute(env, command)
                last.note(command, answer)
    except StopIteration as end:
        check_last(command)
        result: T = end.value
        return result
    except BaseException:
        last.forget()
        flight.close()
        raise


class SerialFleet:
    """A `Fleet` that runs one job after the other, on its environments in turn."""

    def __init__(self, *envs: VectorEnv) -> None:
        """Use one or more environments of the same kind."""
        self._envs = envs
        self._snapshots = [LastSnapshot() for _ in envs]

    @property
    def spec(self) -> WorldSpec:
        """The shape of each environment's world."""
        return self._envs[0].spec

    @property
    def messages_dropped(self) -> int:
        """Number of messages ignored so far: 0 for worlds of this process."""
        return sum(getattr(env, 'messages_dropped', 0) for env in self._envs)

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Run all jobs and yield their results in order; see :class:`Fleet`."""
        for number, begin in enumerate(flights):
            index = number % len(self._envs)
            for attempt in range(1, MAX_ATTEMPTS + 1):
                try:
                    result = fly(self._envs[index], begin(), poll, self._snapshots[index])
                    break
                except EnvironmentRestarted as error:
                    report(f'simulator restarted; its job starts again: {error}')
                    if attempt == MAX_ATTEMPTS:
                        raise
            yield result
