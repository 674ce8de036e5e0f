# SPDX-License-Identifier: Apache-2.0
"""Simulators over DDS, stepped together as one world; needs ROS 2."""
from __future__ import annotations

import secrets
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier

from rocket_sim_node.gym import keywords
from rocket_sim_node.settings import whole_number
from rocket_sim_node.wire.client.client import RELEASE_TIMEOUT
from rocket_sim_node.wire.client.client import ask_all
from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.membership import FleetMembership
from rocket_sim_node.wire.dds import security
from rocket_sim_node.wire.dds.transport import prepared
from rocket_sim_node.wire.node.polling import PolledEntity
from rocket_sim_node.wire.node.running import make_executor
from rocket_sim_node.wire.node.waiting import Waiter
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds.actions import commanded
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.jobs import Command
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot

_NODE = 'gymnasium_agent'


class Simulators:
    """Simulators whose rockets are one batch: those of the first by name, then the second's.

    It has a ROS context and a node of its own, which it spins only while it waits.
    """

    def __init__(self, world: str, num_envs: int, pattern: str, patience: float) -> None:
        """Wait until enough simulators have joined to supply `num_envs` rockets.

        :param world: the world that they must fly.
        :param num_envs: rockets of all simulators together.
        :param pattern: namespaces of the simulators, such as `/sim_*`.
        :param patience: seconds to wait for an answer.
        :raises ValueError: for another world, or a number of rockets that they cannot make up.
        :raises WireTimeout: when there are not enough.
        """
        self._connections: list[Connection] = []
        self._closing = ExitStack()
        self._sent: NDArray[Any] | None = None
        """Action of a step that was sent, and of which not all answers have been returned."""
        try:
            self._connect(world, num_envs, pattern, patience)
        except BaseException:
            self.close()
            raise

    def _connect(self, world: str, num_envs: int, pattern: str, patience: float) -> None:
        context = Context()
        security.require(_NODE, [])
        with prepared(get_rmw_implementation_identifier()):
            rclpy.init(args=[], context=context)
            self._closing.callback(rclpy.shutdown, context=context)
            node = Node(f'{_NODE}_{secrets.token_hex(4)}', context=context)
        self._closing.callback(node.destroy_node)
        self._closing.callback(PolledEntity.destroy_all, node)
        executor = make_executor(context)
        executor.add_node(node)
        self._closing.callback(executor.remove_node, node)
        options = ConnectionOptions(patience=patience)
        members = FleetMembership(node, options, secrets.randbits(63) + 1, pattern)
        self._closing.callback(members.close)
        self._waiter = Waiter(node, executor, patience)

        def found() -> bool:
            members.look()
            return members.spec is not None

        self._waiter.wait(found, 'a description', members.where)
        first = members.spec
        assert first is not None
        if first.name != world:
            raise ValueError(
                f'simulators: those of {pattern} fly world {first.name!r}, expected {world!r}')
        count, rest = divmod(num_envs, first.num_envs)
        if rest or not count:
            raise ValueError(
                f'num_envs: got {num_envs}, expected a multiple of {first.num_envs}, the rockets '
                f'of each simulator of {pattern}')

        def complete() -> bool:
            members.look()
            return sum(member.fits for member in members) >= count

        self._waiter.wait(complete, f'{count} descriptions', members.where)
        fitting = [member.connection for member in members if member.fits]
        self._connections = sorted(fitting, key=lambda connection: connection.name)[:count]
        self._each = first.num_envs
        self._spec = replace(first, num_envs=num_envs)

    @property
    def spec(self) -> WorldSpec:
        """The shape of the world, with the rockets of all simulators."""
        return self._spec

    def reset(self, seed: int | None = None, **settings: Any) -> F32:
        """Start new episodes, in simulator k with seed + k; see `worlds.VectorEnv`."""
        if seed is not None:
            # Checked here, before the first simulator begins.
            most = 2**63 - len(self._connections)
            seed = whole_number('seed', seed, 0, most, f'2**63 - {len(self._connections)}')
        keywords.check_values(self._spec.name, settings)
        self._sent = None
        observations: list[F32] = self._ask([
            Reset(None if seed is None else seed + number, settings)
            for number in range(len(self._connections))])
        return np.concatenate(observations)

    def step(
        self, action: NDArray[Any],
    ) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by one step; see `worlds.VectorEnv`.

        :raises EnvironmentRestarted: when a simulator is in another session.
        :raises WireTimeout: when there is no answer. The same action may be sent again.
        :raises ValueError: for another action after a step that failed or was interrupted: some
            of the simulators may have taken that step.
        """
        # Although each connection does so, too: an invalid row must stop the actions of all
        # simulators, and the error names the row of the whole batch.
        action = commanded(self._spec, action)
        if self._sent is not None and not np.array_equal(action, self._sent):
            raise ValueError(
                'action: got another one than that of the last step, which was sent but not '
                'answered, expected the same one, or a reset')
        self._sent = action.copy()
        answers = self._ask(np.split(action, len(self._connections)))
        self._sent = None
        observation, reward, terminated, truncated = (
            np.concatenate(parts) for parts in list(zip(*answers, strict=True))[:4])
        infos = [answer[4] for answer in answers]
        offsets = [number * self._each for number in range(len(infos))]
        return observation, reward, terminated, truncated, {
            'final_rows': np.concatenate([
                info['final_rows'] + offset
                for info, offset in zip(infos, offsets, strict=True)]),
            'final_observation': np.concatenate([info['final_observation'] for info in infos]),
            'episodes': _joined([info['episodes'] for info in infos], offsets)}

    def snapshot(self) -> bytes:
        """Return the exact state of all simulators; of one, that which it has in process."""
        states: list[bytes] = self._ask([Snapshot() for _ in self._connections])
        if len(states) == 1:
            return states[0]
        return snapshots.pack(self._spec, {
            f'simulator_{number}': np.frombuffer(state, np.uint8)
            for number, state in enumerate(states)})

    def restore(self, state: bytes) -> F32:
        """Restore all simulators; return the observation `(N, D)`.

        :raises ValueError: when the snapshot is damaged or of other simulators.
        """
        states = [state]
        if len(self._connections) > 1:
            like = {f'simulator_{number}': np.zeros(0, np.uint8)
                    for number in range(len(self._connections))}
            arrays = snapshots.unpack(self._spec, state, like, tuple(like))
            states = [arrays[name].tobytes() for name in like]
        self._sent = None
        observations: list[F32] = self._ask([Restore(each) for each in states])
        return np.concatenate(observations)

    def _ask(self, commands: Sequence[Command]) -> list[Any]:
        return ask_all(self._waiter, self._connections, commands)

    def close(self) -> None:
        """Release the simulators for other agents, and leave ROS; may be called again."""
        farewells = [connection.release() for connection in self._connections]
        if farewells:
            self._waiter.linger(lambda: all(done() for done in farewells), RELEASE_TIMEOUT)
        self._connections = []
        self._closing.close()


def _joined(parts: list[Episodes], offsets: list[int]) -> Episodes:
    """Return the finished episodes of all simulators, with their rows in the whole batch."""
    moved = [replace(part, row=part.row + offset)
             for part, offset in zip(parts, offsets, strict=True)]
    return Episodes.concatenate(moved)
