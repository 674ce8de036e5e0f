# SPDX-License-Identifier: Apache-2.0
"""A simulator somewhere, used like a world in this process."""
from __future__ import annotations

import secrets
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.executors import Executor
from rclpy.node import Node

from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.node.waiting import Waiter
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import Command
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot

RELEASE_TIMEOUT = 1.0
"""s that a farewell may take"""


class Client:
    """A simulator as a `VectorEnv`: resets, steps, re-sends, and says when it restarted.

    It spins `executor` only while it waits, in the thread that calls it, so that the other
    callbacks of the node are served in between and nothing is nested.
    """

    def __init__(
        self,
        node: Node,
        executor: Executor,
        options: ConnectionOptions | None = None,
        agent: int | None = None,
    ) -> None:
        """Advertise; `connect`, `reset` or `restore` come next.

        :param agent: identity, 1 to 2**64 - 1. One that comes back under the same identity may
            go on at once; None draws a new one.
        """
        options = options or ConnectionOptions()
        self.node = node
        self.waiter = Waiter(node, executor, options.patience)
        self.link = Connection(node, options, agent or secrets.randbits(63) + 1)

    def __enter__(self) -> Client:
        """Use as a context that lets go of the simulator at the end."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go."""
        self.close()

    @property
    def spec(self) -> WorldSpec:
        """The world at the far end; waits for it the first time.

        :raises WireTimeout: when no simulator shows up.
        """
        return self.connect() if self.link.world is None else self.link.spec

    def connect(self) -> WorldSpec:
        """Wait for a simulator and return what it is.

        :raises WireTimeout: when none shows up.
        """
        self.waiter.wait(lambda: self.link.world is not None, 'a description')
        return self.link.adopt_spec()

    def reset(self, seed: int | None = None, **settings: Any) -> F32:
        """Begin new episodes; see :class:`VectorEnv`.

        A simulator that is slow to answer is asked again, and without a seed each time begins the
        episodes that come next: for flights that can be repeated give a seed.

        :raises WireTimeout: when there is no answer.
        :raises SimulatorBusy: when another agent keeps it.
        """
        observation: F32 = self._do(Reset(seed, settings))
        return observation

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by one step, exactly once, whatever gets lost on the way.

        With a simulator in real time it waits for a later step than the last, and answers with the
        newest there is: rewards and ends of those passed over come with it, of four at most.

        :raises ValueError: for bad actions; nothing was sent.
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
        """Put all rockets back into a snapshot; see :class:`VectorEnv`."""
        observation: F32 = self._do(Restore(state))
        return observation

    def _do(self, command: Command) -> Any:
        link = self.link
        if link.world is None:
            self.connect()
        link.drop()
        link.ask(command)
        try:
            while True:
                mailbox = link.mailbox
                seconds = link.deadline - time.monotonic()
                if mailbox is None:
                    self.waiter.spin(seconds)
                else:
                    self.waiter.attend(seconds, [mailbox])
                if link.poll():
                    return link.take()
        except BaseException:
            link.drop()
            raise

    @property
    def session(self) -> int:
        """The session that this client flies in; 0 outside of one."""
        return self.link.session

    @property
    def realtime(self) -> bool:
        """Whether the simulator goes by the clock; known once connected."""
        return self.link.realtime

    @property
    def resent(self) -> int:
        """How many actions were sent again."""
        return self.link.resent

    def close(self) -> None:
        """Let go of the simulator, so that another agent need not wait."""
        self.waiter.linger(self.link.release(), RELEASE_TIMEOUT)
