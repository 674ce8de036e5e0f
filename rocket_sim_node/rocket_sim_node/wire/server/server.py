# SPDX-License-Identifier: Apache-2.0
"""Server of one world: steps it with the actions of one agent and publishes the results."""
from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs import msg
from rocket_msgs import srv

from rocket_sim_node import free_memory
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.stamps import SimulatedTime
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.answer_digest import answer_digest
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher
from rocket_sim_node.wire.node.diagnostics import shortened
from rocket_sim_node.wire.node.peer import Peer
from rocket_sim_node.wire.node.peer import known_publisher
from rocket_sim_node.wire.node.peer import participant_of
from rocket_sim_node.wire.node.peer import writers
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.wire.node.polling import PollingWaitSet
from rocket_sim_node.wire.node.steady_clock import create_timer
from rocket_sim_node.wire.server import real_time
from rocket_sim_node.wire.server.control import NOBODY
from rocket_sim_node.wire.server.control import ControlLease
from rocket_sim_node.wire.server.control_services import ControlServices
from rocket_sim_node.wire.server.duplicate_simulators import DuplicateDetector
from rocket_sim_node.wire.server.idle_stepper import IdleStepper
from rocket_sim_node.wire.server.real_time import RealTime
from rocket_sim_node.wire.server.state_stream import StateStream
from rocket_sim_node.wire.server.step_messages import ResultPublisher
from rocket_sim_node.worlds.actions import Clipped
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.actions import idle_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import SimulatedWorld

_SPIN_PERIOD = 0.2
"""Seconds per wait; Python handles signals only between two waits."""
_MOST_STATES = 50_000
"""Maximum samples in a message of `state`, 10 MB."""
_MODES = {msg.World.LOCKSTEP: 'lockstep', msg.World.REALTIME: 'realtime'}
_EVENTS = (
    *(f'refused on {where}' for where in ('action', 'reset', 'restore', 'snapshot', 'release')),
    'repeated answers', 'differing repeats', 'second simulator seen')
_GONE = 0.75
"""Seconds of silence after which an agent may have been killed and started again. Longer than the
time between two keep-alives, and shorter than an agent takes to start."""


@dataclass(frozen=True)
class ServerOptions:
    """Settings of a server."""

    mode: int = msg.World.LOCKSTEP
    realtime_factor: float = 1.0
    """Simulated seconds per second, real-time mode only."""
    action_timeout: float = 0.5
    """Seconds without a new action before the engine is cut, 2.5 steps at least; real time."""
    agent_lease: float = 10.0
    """Seconds of silence after which another agent may take over."""
    acknowledge: str = 'auto'
    """One of `qos.ACKNOWLEDGE`."""
    state_rows: int = 4
    """Rockets, from row 0, whose state is published."""
    state_batch: int = 50
    """Steps collected in one message of `state`."""


class Server:
    """Serves a world on the protocol's topics and services, on `node`.

    Lock-step: the world advances exactly once for each action that names the current session and
    step, and never otherwise. A repeated action for the step just taken is answered with the same
    result again; any other stale, early, foreign or malformed action is refused, counted and
    logged, and changes nothing. Real time: the world advances by a timer and holds the last
    action.
    """

    def __init__(self, node: Node, world: SimulatedWorld, options: ServerOptions) -> None:
        """Publish the world's description and wait for an agent.

        :raises ValueError: when another agent could take over before the engine is cut, or when
            messages of `state` would be too large.
        """
        realtime = options.mode == msg.World.REALTIME
        rows = min(options.state_rows, world.spec.num_envs)
        batch = 1 if realtime else options.state_batch
        if rows * batch > _MOST_STATES:
            raise ValueError(
                f'state_batch: got {batch}, which with {rows} rockets (state_rows) makes '
                f'messages of {rows * batch} states, expected at most {_MOST_STATES}')
        self._node = node
        self._world = world
        self._options = options
        self._lease = ControlLease(options.agent_lease)
        self._session = 0
        self._step = 0
        self._time = SimulatedTime(world.spec.dt)
        self._answer = b''
        """Digest of the last answer of a service."""
        self._flown: Any = None
        """The action that the last step was taken with; None before the first of a session."""
        self._clipped = Clipped(world.spec)
        self._health = DiagnosticsPublisher(
            node, (*_EVENTS, *real_time.EVENTS) if realtime else _EVENTS, self._present)
        self._world_publisher, own = known_publisher(node, msg.World, 'world', qos.WORLD)
        self._peer = Peer(node, self._health, own)
        """The participant of the agent in control."""
        self._duplicates = DuplicateDetector(node, self._peer, self._health, participant_of(own))
        period = world.spec.dt / options.realtime_factor
        self._realtime = RealTime(
            period, options.action_timeout, idle_action(world.spec), self._lease, self._health,
        ) if realtime else None
        self._result = ResultPublisher(node)
        self._state = StateStream(node, world, rows, batch)
        self._actions = ArraySubscription(
            node, msg.Action, 'action', qos.read_stream(options.acknowledge))
        self._services = ControlServices(node, participant_of(own), (
            (srv.Reset, '~/reset', self._on_reset),
            (srv.Snapshot, '~/snapshot', self._on_snapshot),
            (srv.Restore, '~/restore', self._on_restore),
            (srv.Release, '~/release', self._on_release)))
        self._begin_session(world.observe())
        self._unflown = [*self._services.current, *self._services.deprecated]
        self.idle_stepper = IdleStepper(
            node, world, self._lease, self._peer, self._realtime, self._state, self._advance,
            self._begin_session)
        self._timers = [create_timer(node, period, self._on_tick)] if realtime else []
        create_timer(node, free_memory.PERIOD, free_memory.give_back)
        create_timer(node, DuplicateDetector.PERIOD, self._duplicates.look)

    @property
    def present(self) -> tuple[int, int]:
        """The current session and step."""
        return self._session, self._step

    @property
    def time(self) -> int:
        """The current simulated time, ns; see `SimulatedTime`."""
        return self._time.at(self._step)

    def attend(self, services: list[Any]) -> None:
        """Answer further services at once while no agent flies, not only every 0.05 s."""
        self._unflown += services

    def _awaited(self) -> list[Any]:
        """Return the services whose requests end a wait: while an agent flies, only its own."""
        return self._unflown if self._lease.owner == NOBODY else self._services.current

    def serve(self, executor: Executor) -> None:
        """Serve until this process is asked to stop.

        :param executor: the node's; serves everything but the actions.
        """
        wait_set = PollingWaitSet(self._node, executor)
        while not stopping.requested():
            wait_set.wait(
                [self._actions], _SPIN_PERIOD, services=self._awaited(), timers=self._timers)
            self._take_action()
        self._state.flush()

    def _take_action(self) -> None:
        """Handle the oldest action that has arrived, if there is one."""
        try:
            message = self._actions.take()
        except ValueError as error:
            self._health.refuse('action', str(error))
            return
        if message is not None:
            self._on_action(message)

    # Actions

    def _on_action(self, message: Any) -> None:
        """Step the world, repeat the last answer, or refuse the action."""
        refusal = self._lease.stranger(message.agent)
        if not refusal:
            refusal = self._past_session(message)
            if not self._peer.accepts('action', self._actions.sender):
                self._peer.drop('action', self._actions.sender, (
                    f'acts as agent {message.agent}, which is another participant: ignored'))
                return
        refusal = refusal or self._untimely_action(message)
        if refusal:
            self._health.refuse('action', refusal)
            if (message.agent, message.session) == (self._lease.owner, self._session) and (
                    self._realtime is None and message.step < self._step):
                self._result.publish()  # so that its sender learns how far ahead this world is
            return
        if self._realtime and message.step == self._realtime.step:
            # Repeated or late, so not for this step; its sender may not be receiving observations.
            self._health.count('repeated actions')
            return
        if self._realtime is None and message.step == self._step - 1:
            self._repeat(message)
            return
        try:
            given = conversion.action_from_message(message, self._world.spec)
            action = checked_action(self._world.spec, given)
        except ValueError as error:
            self._health.refuse('action', str(error))
            return
        if self._realtime is None:
            self._flown = message
            self._advance(action)
            # After the answer, as the agent is waiting for it. Only counted: a learning agent
            # also explores beyond the bounds.
            self._clipped.note(given, action)
            return
        if self._clipped.note(given, action):
            self._health.warn('clipped actions', f'action: clipped: {self._clipped.last}')
        self._realtime.follow(action, message.step)

    def _repeat(self, message: Any) -> None:
        """Publish the last answer again; report an action that is not the one it belongs to."""
        self._health.count('repeated answers')
        flown = self._flown
        if flown is not None and any(
                theirs.tobytes() != ours.tobytes() for theirs, ours in (
                    (message.continuous, flown.continuous), (message.discrete, flown.discrete))):
            sender = self._actions.sender
            self._health.fault('differing repeats', sender, lambda: (
                f'action: {self._peer.named(sender, writers(self._node, "action"))} repeats step '
                f'{message.step} with values that differ from those applied; the answer is '
                'that to the applied ones'))
        self._result.publish()

    def _past_session(self, message: Any) -> str:
        """Return why an action is not for this session; empty if it is."""
        if message.session != self._session:
            # The sender may have missed the new session: publish it again.
            self._publish_world()
            return f'session: {message.session}, expected {self._session}'
        return ''

    def _untimely_action(self, message: Any) -> str:
        """Return why an action of the agent in control does not apply now; empty if it does."""
        self._lease.heard()
        oldest = max(self._realtime.step if self._realtime else self._step - 1, 0)
        if not oldest <= message.step <= self._step:
            expected = f'{oldest} to {self._step}' if oldest < self._step else f'{oldest}'
            return f'step: {message.step}, expected {expected}'
        return ''

    def _advance(self, action: NDArray[Any]) -> None:
        observation, reward, terminated, truncated, info = self._world.step_checked(action)
        self._step += 1
        self._result.fill(
            self._session, self._step, observation, reward, terminated, truncated, info)
        self._result.publish()
        self._state.add(self._session, self._step, self.time)

    def _on_tick(self) -> None:
        """Advance by dt in real time, if an agent is in control."""
        assert self._realtime is not None
        action = self._realtime.due()
        if action is not None:
            self._advance(action)

    # Services

    def _on_reset(self, request: srv.Reset.Request, response: Any, caller: bytes) -> Any:
        def begin() -> F32:
            settings = conversion.settings_from_message(
                request.settings, worlds.units(self._world.spec.name))
            if request.seed < -1:
                raise ValueError(f'seed: got {request.seed}, expected 0 or more, or -1')
            return self._world.reset(None if request.seed == -1 else request.seed, **settings)
        return self._take_control('reset', request, begin, response, caller)

    def _on_restore(self, request: srv.Restore.Request, response: Any, caller: bytes) -> Any:
        def begin() -> F32:
            return self._world.restore(bytes(request.state))
        return self._take_control('restore', request, begin, response, caller)

    def _take_control(
        self, name: str, request: Any, begin: Callable[[], F32], response: Any, caller: bytes,
    ) -> Any:
        """Handle a service call that gives an agent control and draws a new session."""
        agent = request.agent
        response.message = self._lease.refusal(agent)
        if not response.message and agent == self._lease.owner and self._lease.silent < _GONE:
            response.message = self._impostor(name, agent, caller)
        if response.message:
            response.code = response.BUSY
            return self._refuse(name, agent, response)
        try:
            if agent == NOBODY:
                raise ValueError('agent: got 0, expected the identity of the caller, 1 or more')
            observation = begin()
        except (ValueError, TypeError) as error:
            response.code = response.INVALID
            response.message = shortened(str(error))
            return self._refuse(name, agent, response)
        self._lease.take(agent)
        self._peer.participant = participant_of(
            caller if caller in self._peer.clients(self._services.names(name))
            else bytes(request.writer))
        self._begin_session(observation)
        response.code = response.OK
        response.session = self._session
        response.step = self._step
        response.observation = conversion.to_sequence(observation, 'f4')
        return response

    def _on_snapshot(
        self, request: srv.Snapshot.Request, response: Any, caller: bytes,
    ) -> Any:
        # A forged call would keep a dead agent's lease alive, and a snapshot changes later steps
        # of worlds with contact: it clears the solver's memory.
        response.message = self._lease.stranger(request.agent) or self._impostor(
            'snapshot', request.agent, caller)
        if response.message:
            response.code = response.BUSY
        elif (request.session, request.step) != (self._session, self._step):
            response.code = response.INVALID
            response.message = (
                f'session and step: {request.session}, {request.step}, '
                f'expected {self._session}, {self._step}')
        else:
            self._lease.heard()
            response.code = response.OK
            response.state = conversion.to_sequence(
                np.frombuffer(self._world.snapshot(), np.uint8), 'u1')
            self._announce(request.agent, response.code, response.state)
            return response
        return self._refuse(
            'snapshot', request.agent, response, request.session, request.step)

    def _refuse(
        self, name: str, agent: int, response: Any, session: int = 0, step: int = 0,
    ) -> Any:
        """Announce and report an answer that refuses a call; return it."""
        self._answer = answer_digest(agent, response.code, session, step)
        self._publish_world()
        self._health.refuse(name, response.message)
        return response

    def _announce(self, agent: int, code: int, content: Any) -> None:
        """Publish the digest of an answer for this session and step, ahead of the answer."""
        self._answer = answer_digest(agent, code, self._session, self._step, content)
        self._publish_world()

    def _impostor(self, name: str, agent: int, caller: bytes) -> str:
        """Return why a call in the name of the agent in control is refused; report its sender.

        :return: empty if the agent itself calls, as far as that can be told.
        """
        services = self._services.names(name)
        if agent != self._lease.owner or self._peer.calls(services, caller):
            return ''
        self._peer.drop(
            name, caller, f'calls as agent {agent}, which is another participant: refused',
            self._peer.clients(services))
        return (
            f'agent: {agent}, but another process controls this simulator as that agent '
            f'(heard {self._lease.silent:.1f} s ago)')

    def _on_release(self, request: srv.Release.Request, response: Any, caller: bytes) -> Any:
        # The agent's last actions: a topic and a service have no common order.
        for _ in range(qos.STREAM.depth):
            self._take_action()
        impostor = self._impostor('release', request.agent, caller)
        if not impostor and self._lease.release(request.agent):
            response.code = response.OK
            if self._realtime:
                self._realtime.begin()
            self._health.clear('the agent has released control')
            self._state.flush()
        else:
            response.code = response.BUSY
            response.message = impostor or (
                f'agent: {request.agent} does not control this simulator')
            self._health.refuse('release', response.message)
        return response

    def _begin_session(self, observation: F32, restart_time: bool = False) -> None:
        """Draw a new session and publish its first observation.

        :param restart_time: whether the simulated time begins at 0 again.
        """
        self._state.flush()
        self._session = secrets.randbits(63) + 1
        self._time.begin_session(self._step)
        if restart_time:
            self._time.restart()
        self._step = 0
        self._flown = None
        if self._realtime:
            self._realtime.begin()
        self._health.clear('a new session has begun')
        self._result.fill_first(self._session, observation)
        self._announce(
            self._lease.owner, srv.Reset.Response.OK, conversion.to_sequence(observation, 'f4'))
        self._result.publish()
        self._state.add(self._session, self._step, self.time)

    def _publish_world(self) -> None:
        self._world_publisher.publish(conversion.world_to_message(
            self._world.spec, self._session, self._step, self._options.mode,
            self._world.flown_settings, self._answer))

    def _present(self) -> dict[str, object]:
        """Return the current values for diagnostics."""
        spec = self._world.spec
        return {
            'world': spec.name, 'num_envs': spec.num_envs, 'mode': _MODES[self._options.mode],
            'session': self._session, 'step': self._step,
            'agent': 'nobody' if self._lease.owner == NOBODY else self._lease.owner,
            **{f'clipped {axis}': count for axis, count in self._clipped.counts.items()},
            'last clipped': self._clipped.last,
        }
