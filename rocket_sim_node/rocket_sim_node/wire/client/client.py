# SPDX-License-Identifier: Apache-2.0
"""A remote simulator with the interface of a world in this process."""
from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.wire.node.waiting import Waiter
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import Command
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot

RELEASE_TIMEOUT = 1.0
"""Seconds to wait for the answer to a release."""


def ask_all(
    waiter: Waiter, connections: Sequence[Connection], commands: Sequence[Command],
) -> list[Any]:
    """Send each simulator its command and return all answers, once they are there."""
    for connection in connections:
        connection.drop()
    try:
        for connection, command in zip(connections, commands, strict=True):
            connection.ask(command)
        waiting = list(connections)
        while waiting:
            await_any(waiter, waiting)
            waiting = [connection for connection in waiting if not connection.poll()]
        return [connection.take() for connection in connections]
    except BaseException:
        for connection in connections:
            connection.drop()
        raise


def await_any(
    waiter: Waiter, waiting: Sequence[Connection],
) -> tuple[list[ArraySubscription], bool]:
    """Wait until one of the simulators may have answered, or something is due.

    :return: the subscriptions with messages, and whether anything else may be due.
    """
    polled: list[ArraySubscription] = []
    entities: dict[str, list[Any]] = {'subscriptions': [], 'clients': []}
    for connection in waiting:
        if connection.awaited is not None:
            polled.append(connection.awaited)
            continue
        for kind, found in connection.entities.items():
            entities[kind] += found
    due = min(connection.deadline for connection in waiting)
    full, others = waiter.attend(due - time.monotonic(), polled, **entities)
    return full, others or time.monotonic() >= due


class Client:
    """A remote simulator as a `VectorEnv`: resets, steps, re-sends, detects restarts.

    It spins `executor` only while it waits, in the calling thread, so the node's other callbacks
    are served meanwhile and spinning is never nested.
    """

    def __init__(
        self,
        node: Node,
        executor: Executor,
        options: ConnectionOptions | None = None,
        agent: int | None = None,
    ) -> None:
        """Create publishers and subscriptions; call `connect`, `reset` or `restore` next.

        :param agent: identity, 1 to 2**64 - 1. An agent that returns under the same identity may
            continue at once; None draws a new one.
        """
        options = options or ConnectionOptions()
        self.node = node
        self.waiter = Waiter(node, executor, options.patience)
        self.connection = Connection(node, options, agent or secrets.randbits(63) + 1)

    def __enter__(self) -> Client:
        """Use as a context that releases the simulator on exit."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the simulator."""
        self.close()

    @property
    def spec(self) -> WorldSpec:
        """The simulator's world; the first access waits for it.

        :raises WireTimeout: when no simulator appears.
        """
        return self.connect() if self.connection.world is None else self.connection.spec

    def connect(self) -> WorldSpec:
        """Wait for a simulator and return the shape of its world.

        :raises WireTimeout: when none appears.
        """
        self.waiter.wait(
            lambda: self.connection.look() is not None, 'a description', '',
            **self.connection.entities)
        return self.connection.adopt_spec()

    def reset(self, seed: int | None = None, **settings: Any) -> F32:
        """Start new episodes; see :class:`VectorEnv`.

        A simulator that is slow to answer is asked again. Without a seed, each request begins the
        next episodes; pass a seed for repeatable flights.

        :raises WireTimeout: when there is no answer.
        :raises SimulatorBusy: when another agent keeps control of it.
        """
        observation: F32 = self._do(Reset(seed, settings))
        return observation

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by exactly one step, even if messages are lost.

        In real time, wait for a step later than the last one and return the newest available.
        Rewards and episode ends of skipped steps are included, for at most four steps.

        :raises ValueError: for invalid actions; nothing was sent.
        :raises EnvironmentRestarted: when the simulator is in another session.
        :raises WireTimeout: when there is no answer.
        """
        answer: tuple[F32, F32, Bools, Bools, dict[str, Any]] = self._do(np.asarray(action))
        return answer

    def snapshot(self) -> bytes:
        """Return the exact state of all rockets; see :class:`VectorEnv`.

        :raises EnvironmentRestarted: when the simulator is in another session.
        :raises WireTimeout: when there is no answer.
        """
        state: bytes = self._do(Snapshot())
        return state

    def restore(self, state: bytes) -> F32:
        """Restore all rockets from a snapshot; see :class:`VectorEnv`."""
        observation: F32 = self._do(Restore(state))
        return observation

    def _do(self, command: Command) -> Any:
        if self.connection.world is None:
            self.connect()
        return ask_all(self.waiter, [self.connection], [command])[0]

    @property
    def session(self) -> int:
        """The session of the last reset or restore; 0 before the first."""
        return self.connection.session

    @property
    def realtime(self) -> bool:
        """Whether the simulator runs in real time; known once connected."""
        return self.connection.realtime

    @property
    def resent(self) -> int:
        """Number of actions that were sent again."""
        return self.connection.resent

    @property
    def messages_dropped(self) -> int:
        """Number of messages ignored because they came from another participant."""
        return self.connection.messages_dropped

    def close(self) -> None:
        """Release the simulator, so that another agent can take it at once."""
        self.waiter.linger(self.connection.release(), RELEASE_TIMEOUT)
