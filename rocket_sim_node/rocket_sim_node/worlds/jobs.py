# SPDX-License-Identifier: Apache-2.0
"""Flights: work with a simulator, written so that many can be flown at once.

A flight is a generator. It yields a command and is sent the environment's answer, until it
returns its result:

>>> def drop(seed: int) -> Flight[float]:
...     observation = yield Reset(seed)
...     observation, reward, terminated, truncated, info = yield engine_off
...     return float(reward.sum())

It begins with `Reset` or `Restore`, so it does not matter where it is flown, nor how often it has
been begun before: a fleet may fly it anywhere, and again when a simulator was lost.
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

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.errors import EnvironmentRestarted
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import VectorEnv
from rocket_sim_node.worlds.base import WorldSpec

T = TypeVar('T')
MAX_ATTEMPTS = 20
"""How often a flight is begun before its restarts are taken for a fault."""


@dataclass(frozen=True)
class Reset:
    """Begin new episodes; answered with the observation `(N, D)`, as by `VectorEnv.reset`."""

    seed: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Restore:
    """Go back into a snapshot; answered with the observation `(N, D)`."""

    state: bytes


@dataclass(frozen=True)
class Snapshot:
    """Tell the exact state; answered with bytes."""


Command = Reset | Restore | Snapshot | NDArray[Any]
"""What a flight yields; an array is an action, answered as by `VectorEnv.step`."""
Job = Generator[Command, Any, T]


class Fleet(Protocol):
    """Environments of one kind, one or many, that fly what they are given."""

    @property
    def spec(self) -> WorldSpec:
        """The shape that the world of each has."""
        ...

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Fly them all and yield their results, in order.

        :param flights: begin a flight each time they are called.
        :param poll: called before each step; may raise, which ends all flights.
        :param report: is told of flights that were begun anew.
        :raises EnvironmentRestarted: when a flight was lost again and again.
        """
        ...


class LastSnapshot:
    """Remembers the snapshot that an environment is at.

    A roll-out mostly begins where the last one ended: that way back need not be gone.
    """

    def __init__(self) -> None:
        """Begin somewhere unknown."""
        self.state: bytes | None = None
        self._observation: F32 | None = None

    def note(self, command: Command, answer: Any) -> None:
        """Take note of what was done."""
        if isinstance(command, Snapshot):
            self.state = answer
            return
        self.state = None
        self._observation = answer[0] if isinstance(command, np.ndarray) else answer

    def cast_off(self) -> None:
        """Forget where the environment is."""
        self.state = self._observation = None

    def answer(self, command: Command) -> F32 | None:
        """Return the answer of a command that would change nothing; None when it has to be done.

        What follows is the same either way, bit for bit.
        """
        if isinstance(command, Restore) and self.state == command.state:
            self.state = None
            return self._observation
        return None


def no_command(found: object) -> TypeError:
    """Return the error for what a flight cannot ask for."""
    return TypeError(
        f'a flight: got {type(found).__name__}, expected Reset, Restore, Snapshot or an array')


def execute(env: VectorEnv, command: Command) -> Any:
    """Have an environment do what a flight wants; return the answer.

    :raises TypeError: for what is no command.
    """
    if isinstance(command, np.ndarray):
        return env.step(command)
    if isinstance(command, Reset):
        return env.reset(command.seed, **command.settings)
    if isinstance(command, Restore):
        return env.restore(command.state)
    if isinstance(command, Snapshot):
        return env.snapshot()
    raise no_command(command)


def fly(
    env: VectorEnv, flight: Job[T], poll: Callable[[], None] = lambda: None,
    mooring: LastSnapshot | None = None,
) -> T:
    """Fly one flight and return its result.

    :param poll: called before each step; may raise.
    :param mooring: what is known of where the environment is.
    :raises EnvironmentRestarted: what was flown is lost.
    """
    mooring = mooring or LastSnapshot()
    answer: Any = None
    try:
        while True:
            command = flight.send(answer)
            answer = mooring.answer(command)
            if answer is None:
                poll()
                answer = execute(env, command)
                mooring.note(command, answer)
    except StopIteration as end:
        result: T = end.value
        return result
    except BaseException:
        mooring.cast_off()
        flight.close()
        raise


class SerialFleet:
    """Flies one flight after the other, dealt to its environments in turn. A `Fleet`."""

    def __init__(self, *envs: VectorEnv) -> None:
        """Take environments of one kind, one or more."""
        self._envs = envs
        self._moorings = [LastSnapshot() for _ in envs]

    @property
    def spec(self) -> WorldSpec:
        """The shape that the world of each has."""
        return self._envs[0].spec

    def fly(
        self,
        flights: Sequence[Callable[[], Job[T]]],
        poll: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda line: None,
    ) -> Iterator[T]:
        """Fly them all and yield their results, in order; see :class:`Fleet`."""
        for number, begin in enumerate(flights):
            place = number % len(self._envs)
            for attempt in range(1, MAX_ATTEMPTS + 1):
                try:
                    result = fly(self._envs[place], begin(), poll, self._moorings[place])
                    break
                except EnvironmentRestarted as error:
                    report(f'simulator restarted, work begins again: {error}')
                    if attempt == MAX_ATTEMPTS:
                        raise
            yield result
