# SPDX-License-Identifier: Apache-2.0
"""Steps a world by idle actions while no agent flies it: single steps, play, pause and reset."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray
from rclpy.node import Node

from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.peer import Peer
from rocket_sim_node.wire.node.peer import writers
from rocket_sim_node.wire.server.control import NOBODY
from rocket_sim_node.wire.server.control import ControlLease
from rocket_sim_node.wire.server.real_time import RealTime
from rocket_sim_node.wire.server.state_stream import StateStream
from rocket_sim_node.worlds.actions import idle_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import SimulatedWorld


class IdleStepper:
    """Moves a world by idle actions (engine off, no torque); agents have precedence.

    Call what moves it only while `flown_by` is empty.
    """

    def __init__(
        self, node: Node, world: SimulatedWorld, lease: ControlLease, peer: Peer,
        realtime: RealTime | None, state: StateStream, advance: Callable[[NDArray[Any]], None],
        begin: Callable[[F32, bool], None],
    ) -> None:
        """Start paused.

        :param peer: the participant of the agent in control.
        :param realtime: None in lock-step.
        :param state: publishes what was flown when a call ends.
        :param advance: steps the world and publishes the result.
        :param begin: draws a new session, in which the observation is the first, and lets the
            simulated time begin at 0 again or go on.
        """
        self._node, self._world, self._lease, self._peer = node, world, lease, peer
        self._realtime, self._state, self._advance, self._begin = realtime, state, advance, begin

    def flown_by(self) -> str:
        """Return a sentence that says which agent has control; empty if none has."""
        there = writers(self._node, 'action') if self._peer.participant else {}
        return self._lease.flown_by(next(
            (name for gid, name in there.items() if self._peer.is_at(gid)), ''))

    @property
    def has_clock(self) -> bool:
        """Whether the world can be played: in real time."""
        return self._realtime is not None

    @property
    def playing(self) -> bool:
        """Whether the world advances by the clock without an agent; paused otherwise."""
        return self._realtime is not None and self._realtime.playing

    def play(self, on: bool) -> None:
        """Let the world advance by the clock, or pause it.

        :raises ValueError: in lock-step, where only actions and steps advance it.
        """
        if self._realtime is not None:
            self._displace()
            self._realtime.playing = on
        elif on:
            raise ValueError(
                'a simulator in lock-step advances by actions and steps only; '
                'start it with mode:=realtime')

    def step(self, count: int) -> int:
        """Advance by steps, at once.

        :return: how many were flown: fewer when this process is asked to stop meanwhile.
        """
        self._displace()
        idle, flown = idle_action(self._world.spec), 0
        while flown < count and not stopping.requested():
            self._advance(idle)
            flown += 1
        self._state.flush()
        return flown

    def begin(self, observation: F32, restart_time: bool = False) -> None:
        """Start a session after the world was reset, or at its present state; play on or not.

        :param restart_time: whether the simulated time begins at 0 again.
        """
        playing = self.playing
        self._lease.release(self._lease.owner)
        self._begin(observation, restart_time)
        self.play(playing)

    def _displace(self) -> None:
        """Take control from an agent whose lease has expired; a new session tells it so."""
        if self._lease.owner != NOBODY:
            self.begin(self._world.observe())
