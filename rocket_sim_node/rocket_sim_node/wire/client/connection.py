# SPDX-License-Identifier: Apache-2.0
"""Agent's connection to one simulator: send, re-send and check answers, without blocking."""
from __future__ import annotations

import math
import time
from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import asdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rocket_msgs import msg
from rocket_msgs import srv

from rocket_sim_node.errors import EnvironmentRestarted
from rocket_sim_node.printable import printable
from rocket_sim_node.wire.client.answers import Answers
from rocket_sim_node.wire.client.answers import observation_of
from rocket_sim_node.wire.client.descriptions import Descriptions
from rocket_sim_node.wire.client.latest_answers import LatestAnswers
from rocket_sim_node.wire.client.service_call import ServiceCall
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.answer_digest import answer_digest
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.wire.messages.definitions import check_definitions
from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher
from rocket_sim_node.wire.node.peer import Peer
from rocket_sim_node.wire.node.peer import known_publisher
from rocket_sim_node.wire.node.peer import participant_of
from rocket_sim_node.wire.node.peer import writers
from rocket_sim_node.wire.node.polling import ArraySubscription
from rocket_sim_node.wire.node.polling import PolledClient
from rocket_sim_node.wire.node.steady_clock import STEADY
from rocket_sim_node.wire.node.waiting import Silence
from rocket_sim_node.worlds.actions import commanded
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Command
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot
from rocket_sim_node.worlds.jobs import no_command
from rocket_sim_node.worlds.random_streams import check_seed
from rocket_sim_node.worlds.rocket import conditions

_NONE = np.zeros(0)
_BUSY_RETRY = 0.5
"""Seconds between attempts to take a simulator that another agent controls."""
_DESCRIPTION_TIMEOUT = 5.0
"""Seconds to wait, after a reset is answered, for the description of its session."""
_KEEP_PERIOD = 0.5
"""Seconds of silence after which `keep` sends a message."""
_LOOK_AFTER = 0.005
"""Seconds of a step without its answer before descriptions are read: that takes 10 us."""
_MOST_NAMED = 5
"""Maximum number of other writers that an error names."""
_COMPARE_PERIOD = 0.5
"""Seconds between comparisons of message definitions while a topic has no peer."""


class WorldChanged(ValueError):
    """A simulator returned with another world."""


class SimulatorBusy(RuntimeError):
    """Another agent controls the simulator and does not release it."""


@dataclass(frozen=True)
class ConnectionOptions:
    """Time-outs and reliability of a connection."""

    resend_after: float = 0.2
    """Seconds without an answer before an action is re-sent; doubled each time, up to 1.6 s."""
    patience: float = 60.0
    """Seconds without an answer before giving up."""
    acknowledge: str = 'auto'
    """One of `qos.ACKNOWLEDGE`."""


class Connection:
    """One simulator: `ask` for something, `poll` until it has come, `take` it.

    The caller spins the node; nothing here blocks. Only one command is pending at a time.
    """

    def __init__(
        self, node: Node, options: ConnectionOptions, agent: int, namespace: str = '',
        health: DiagnosticsPublisher | None = None,
    ) -> None:
        """Create publishers, subscriptions and clients.

        :param agent: identity, 1 to 2**64 - 1.
        :param namespace: of the simulator, with its leading slash; empty: the node's own.
        :param health: reports messages of others than the simulator; None: a new one.
        """
        self._node, self._options, self.agent = node, options, agent
        prefix = f'{namespace}/' if namespace else ''
        self.name = namespace or 'simulator'
        self._spec: WorldSpec | None = None
        self._realtime = False
        self.session = 0
        self.step = 0
        self.resent = 0
        self.heard = 0.0
        """Steady-clock time, s, of the last message from the simulator."""
        self._spoke = 0.0
        self._action = Codec(msg.Action)
        self._message = b''
        self._command: Command | None = None
        self._acted: Act | None = None
        """The step that was answered, and whose results are not recorded."""
        self._answer: Any = None
        self._silence: Silence | None = None
        self._call: ServiceCall | None = None
        self._asked = 0.0
        self._claimed = False
        """Whether the simulator may consider this agent in control."""
        self._flying = False
        """Whether a step was taken since the last reset or restore was requested."""
        self._lost = False
        """Whether the simulator was given up, and no step has succeeded since."""
        self._compare_at = 0.0
        """Steady-clock time, s, of the next comparison of message definitions: at the first step,
        then periodically until all topics have a peer."""
        self._next, self._pause, self._described_by, self._warned = 0.0, 0.0, 0.0, False
        self._publisher, self._writer = known_publisher(
            node, msg.Action, f'{prefix}action', qos.STREAM)
        self._flown_by = b''
        """Participant of the simulator that entered the present session."""
        self._peer = Peer(node, health or DiagnosticsPublisher(node, quiet=True), self._writer)
        self._descriptions = Descriptions(node, prefix, self._peer, self._accept_description)
        self._stream = stream = qos.read_stream(options.acknowledge)
        self._step_subscriptions = [
            ArraySubscription(node, kind, prefix + topic, profile) for kind, topic, profile in (
                (msg.Observation, 'observation', stream),
                (msg.Reward, 'reward', stream),
                (msg.Episodes, 'episodes', qos.EVENTS))]
        self._answers = Answers(self._step_subscriptions, self._warn, self._accepts)
        self._clients = {
            name.rpartition('/')[2]: PolledClient(node, kind, prefix + name) for name, kind in (
                ('simulator/reset', srv.Reset), ('simulator/snapshot', srv.Snapshot),
                ('simulator/restore', srv.Restore))}
        self._release = node.create_client(srv.Release, f'{prefix}simulator/release')

    @property
    def messages_dropped(self) -> int:
        """Messages ignored because they did not come from the simulator."""
        return self._peer.dropped

    def _accepts(self, subscription: ArraySubscription) -> bool:
        """Return whether the simulator sent the last message of this session."""
        if self._peer.accepts(subscription.topic, subscription.sender):
            return True
        known = self._peer.named(self._peer.participant, writers(self._node, self.topic))
        self._peer.drop(
            subscription.topic, subscription.sender,
            f'publishes on this topic in the session of simulator {known}: ignored')
        return False

    # Description of the simulator

    @property
    def world(self) -> msg.World | None:
        """The simulator's latest description, as read last."""
        return self._descriptions.world

    @world.setter
    def world(self, message: msg.World | None) -> None:
        self._descriptions.world = message

    @property
    def topic(self) -> str:
        """Full name of the topic that describes the simulator."""
        return self._descriptions.topic

    @property
    def realtime(self) -> bool:
        """Whether the simulator runs in real time; known once described."""
        return self.described_realtime if self._spec is None else self._realtime

    @property
    def described_realtime(self) -> bool:
        """Whether the simulator's latest description says real time."""
        return self.world is not None and self.world.mode == msg.World.REALTIME

    @property
    def spec(self) -> WorldSpec:
        """The simulator's world, once described."""
        return self._spec or self.adopt_spec()

    def _accept_description(self, message: msg.World) -> bool:
        if self._spec is not None:
            try:
                conversion.world_from_message(message)
            except ValueError as error:  # from whatever publisher, it is not the adopted world
                self._warn(f'message ignored: {error}')
                return False
        self.heard = time.monotonic()
        return True

    def _reconsider(self) -> None:
        """Let another participant be the simulator, if the known one does not answer."""
        self._descriptions.reconsider(time.monotonic() - max(self._asked, self.heard))

    def look(self) -> msg.World | None:
        """Read the descriptions that have arrived; return the simulator's latest."""
        self._descriptions.read()
        return self.world

    def described(self) -> WorldSpec:
        """Return the shape of the world as last described.

        :raises ValueError: for an invalid description, or one from a node that was built with
            other message definitions.
        """
        self._compare_definitions(again=0.0)
        assert self.world is not None
        return conversion.world_from_message(self.world)

    def _compare_definitions(self, again: float) -> None:
        known = check_definitions(
            self._node, [self.topic, *(one.topic for one in self._step_subscriptions)],
            [self._publisher.topic_name])
        self._compare_at = math.inf if known else again

    def _compare_late(self) -> None:
        now = time.monotonic()
        if now >= self._compare_at:
            self._compare_definitions(again=now + _COMPARE_PERIOD)

    def adopt_spec(self) -> WorldSpec:
        """Adopt the shape of the world as last described.

        :raises WorldChanged: when it differs from the one adopted before.
        :raises ValueError: as `described` does.
        """
        spec = self.described()
        if self._spec is None:
            self._acknowledge_large(spec)
            self._spec, self._realtime = spec, self.described_realtime
            kind = LatestAnswers if self._realtime else Answers
            self._answers = kind(self._step_subscriptions, self._warn, self._accepts)
            self._answers.expect(spec)
        change = ''
        if spec != self._spec:
            change = difference(self._spec, spec)
        elif self.described_realtime != self._realtime:
            modes = 'lockstep', 'realtime'
            change = f'mode is {modes[not self._realtime]}, expected {modes[self._realtime]}'
        if change:
            raise WorldChanged(f'{self.name} restarted with another world: {change}')
        return self._spec

    def _acknowledge_large(self, spec: WorldSpec) -> None:
        """Subscribe again to observations and rewards that are too large to go unacknowledged.

        A reward is largest when all episodes end: it has the last observation of each.
        """
        stream = qos.read_stream(
            self._options.acknowledge, spec.num_envs * (4 * spec.observation_size + 10))
        if stream == self._stream:
            return
        for number, kind in enumerate((msg.Observation, msg.Reward)):
            topic = self._step_subscriptions[number].topic
            self._step_subscriptions[number].destroy()
            self._step_subscriptions[number] = ArraySubscription(self._node, kind, topic, stream)

    # Requests

    @property
    def deadline(self) -> float:
        """Steady-clock time, s, by which `poll` must be called."""
        return self._next

    @property
    def awaited(self) -> ArraySubscription | None:
        """The subscription for the next part of a step's answer.

        None when no part is missing, or no step is pending.
        """
        return self._answers.missing if self._steps else None

    @property
    def arrived(self) -> bool:
        """Whether the awaited parts of a step's answer have arrived."""
        if self._acted is None and isinstance(self._command, Act):
            return self._answers.observe()
        return self._steps and self._answers.collect()

    @property
    def entities(self) -> dict[str, list[Any]]:
        """The node's entities that deliver the answer of a service."""
        return {
            'subscriptions': [self._descriptions.subscription],
            'clients': [] if self._call is None or self._described_by else [self._call.client]}

    def waited(self, now: float) -> float:
        """Return how long the pending answer has been outstanding, s."""
        return now - self._asked if self._command is not None else 0.0

    def ask(self, command: Command) -> None:
        """Send a command to the simulator, once the results of the last step have arrived.

        Then they are recorded, while the simulator works.

        :raises ValueError: for invalid actions; nothing was sent. For invalid results of the last
            step: they are not recorded, but the command was sent.
        """
        acted = self._acted
        if acted is None:
            self._send(command)
        elif self._answers.collect():
            results = self._answers.take_results()
            self._send(command)
            self._acted = None
            acted.record(results())
        else:
            self._command = command

    def _send(self, command: Command) -> None:
        now = self._asked = time.monotonic()
        self._answer = None
        if isinstance(command, Reset | Restore):
            self._flying = False
        if isinstance(command, Act | np.ndarray):
            action = commanded(
                self.spec, command.action if isinstance(command, Act) else command)
            self._message = self._action.encode(
                (self.session, self.step, self.agent),
                (action, _NONE) if self.spec.continuous else (_NONE, action))
            self._answers.await_step(
                self.session, self.step, early=isinstance(command, Act))
            self._publisher.publish(self._message)
            self._pause = self._options.resend_after
            self._next = now + self._pause
            self._silence = Silence(
                self._node, 'an answer', self._options.patience, self.topic)
        else:
            self._described_by, self._warned = 0.0, False
            self._begin_call(command, now)
        self._command = command

    def poll(self) -> bool:
        """Do what is due; return whether the answer has arrived.

        That includes what `ask` does, if it had to wait for the results of the last step.

        :raises EnvironmentRestarted: when the simulator is in another session.
        :raises WireTimeout: when there was no answer for too long.
        :raises SimulatorBusy: when another agent keeps control of it.
        :raises ValueError: when the simulator refuses the command, or the answer is invalid.
        """
        command = self._command
        if self._acted is not None:
            if command is not None and self._poll_step():
                self.ask(command)
            return False
        if self._steps:
            return self._poll_step()
        if self._described_by:
            return self._poll_description()
        return command is not None and self._poll_call(command)

    def take(self) -> Any:
        """Return the answer in the form that the job expects."""
        command, self._command = self._command, None
        self._call = None
        if isinstance(command, Act | np.ndarray):
            self._spoke = self.heard = time.monotonic()
            answer: Any
            if isinstance(command, Act):
                self.step, answer = self._answers.take_observation()
                self._acted = command
            else:
                self.step, answer = self._answers.take()
            self._flying, self._lost = True, False
            self._descriptions.expose()
            return answer
        self._lost = False
        answer, self._answer = self._answer, None
        return answer

    def let_go(self) -> None:
        """Stop sending keep-alives until the next step succeeds; the simulator is given up."""
        self._flying, self._lost = False, True

    def drop(self) -> None:
        """Discard the pending command, and results that are not recorded."""
        self._command = self._call = self._silence = self._acted = None
        self._described_by = 0.0

    def listen(self) -> None:
        """Note late answers of the simulator, or its return, while nothing is pending."""
        self._descriptions.read()
        if self._lost:
            self._reconsider()
        if self._answers.heard_of(self.session):
            self.heard = time.monotonic()

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(
            f'{self.name}: {text}', throttle_duration_sec=1.0, throttle_time_source_type=STEADY)

    # Steps

    @property
    def _steps(self) -> bool:
        """Whether a step's answer is awaited, or the rest of it before a command is sent."""
        return isinstance(self._command, Act | np.ndarray) or self._acted is not None

    def _poll_step(self) -> bool:
        if self.arrived:
            self._compare_late()
            return True
        now = time.monotonic()
        if now - self._asked > _LOOK_AFTER:
            self._reconsider()
        self._check_session()
        if now >= self._next:
            assert self._silence is not None
            self._compare_late()  # differing definitions may be why no answer can be decoded
            self._silence.check(self._next)
            self.resent += 1
            self._publisher.publish(self._message)
            self._pause = min(2 * self._pause, 8 * self._options.resend_after)
            self._next = now + min(self._pause, self._silence.left)
        return False

    @property
    def _same_process(self) -> bool:
        """Whether the simulator is known to be the process that was reset."""
        return bool(self._flown_by) and self._flown_by == self._peer.participant

    def _check_session(self) -> None:
        """Raise when the simulator has announced a session other than ours."""
        if self.world is not None and self.world.session != self.session:
            raise EnvironmentRestarted(
                f'{self.name} is in session {self.world.session}, expected {self.session}: it was '
                + ('reset by another program, or by a delayed request'
                   if self._same_process else 'restarted'))
        if self._answers.ahead:
            topic = self._publisher.topic_name
            others = [self._peer.named(gid, known) for known in [writers(self._node, topic)]
                      for gid in known if participant_of(gid) != participant_of(self._writer)]
            raise EnvironmentRestarted(
                f'{self.name} is at step {self._answers.ahead}, '
                f'expected {self._answers.awaited_step}: '
                f'another node sends actions as agent {self.agent}; other writers of {topic}: '
                f'{", ".join(others[:_MOST_NAMED]) or "none"}')

    def keep(self) -> None:
        """Send a keep-alive while the agent computes; call it often.

        It re-sends the last action, which changes nothing in lock-step. In real time a repeated
        action would be applied again, so none is sent and the watchdog cuts the engine.
        """
        now = time.monotonic()
        if (isinstance(self._command, Act | np.ndarray) or self.realtime
                or not self._flying):
            return  # the pending step is re-sent anyway
        if now - self._spoke > _KEEP_PERIOD:
            self._spoke = now
            self._publisher.publish(self._message)

    # Services

    def _begin_call(self, command: Command, begin: float) -> None:
        self._descriptions.await_answer()
        self._call = ServiceCall(
            self._node, self._clients[_name(command)], self._request(command),
            self._options.patience, self.topic, begin)
        self._next = begin

    def _poll_call(self, command: Command) -> bool:
        """Call the service until it answers, then judge the answer."""
        assert self._call is not None
        now = time.monotonic()
        answers = self._call.poll(now)
        self._next = self._call.due
        self._claimed |= self._call.made and not isinstance(command, Snapshot)
        self._reconsider()
        response = next((one for one in answers if self._is_announced(command, one)), None)
        if response is None:
            return False
        self.heard = now
        self._call.settle()
        self._report_servers(len(answers) - 1 + self._call.doubled)
        self._descriptions.expose()
        return self._judge(command, response, now)

    def _is_announced(self, command: Command, response: Any) -> bool:
        """Return whether the simulator has announced this answer on `world`, before it came."""
        if isinstance(command, Snapshot):
            session, step, content = self.session, self.step, response.state
        else:
            session, step, content = response.session, response.step, response.observation
        return self._descriptions.announced(
            answer_digest(self.agent, response.code, session, step, content))

    def _report_servers(self, count: int) -> None:
        """Count answers of other servers than the simulator, and report who they may be."""
        assert self._call is not None
        name = self._call.client.srv_name
        # The names of the topics of a service in DDS, for all ROS 2 middlewares but Zenoh.
        known = writers(self._node, f'rr{name}Reply', mangled=True) if count else {}
        others = [gid for gid in known if not self._peer.is_at(gid)]
        for _ in range(count):
            self._peer.drop(
                name, others[0] if others else b'', 'also answers on this service: ignored',
                known)

    def _request(self, command: Command) -> Any:
        if isinstance(command, Reset):
            seed = -1 if command.seed is None else check_seed(command.seed)
            return srv.Reset.Request(
                agent=self.agent, writer=list(self._writer), seed=seed,
                settings=conversion.settings_to_message(self._flat(command.settings)))
        if isinstance(command, Restore):
            request = srv.Restore.Request(agent=self.agent, writer=list(self._writer))
            request.state = conversion.to_sequence(np.frombuffer(command.state, np.uint8), 'u1')
            return request
        return srv.Snapshot.Request(agent=self.agent, session=self.session, step=self.step)

    def _flat(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Return the settings of a reset as numbers by name.

        :raises ValueError: for unknown conditions, or ones that this world does not have.
        """
        if 'conditions' in settings:
            conditions.check_world(self.spec, settings['conditions'])
        return conditions.flatten(settings)

    def _judge(self, command: Command, response: Any, now: float) -> bool:
        """Accept a successful answer; retry later when the simulator is busy."""
        name = _name(command)
        if response.code == response.OK:
            self._answer = response
            if isinstance(command, Snapshot):
                self._answer = bytes(response.state)
                return True
            self._described_by = now + _DESCRIPTION_TIMEOUT
            return self._poll_description()
        said = printable(response.message)
        if isinstance(command, Snapshot):
            # Refused because of the session: the simulator is not in the state we assumed.
            raise EnvironmentRestarted(f'snapshot: {said}')
        if response.code != response.BUSY:
            self.adopt_spec()  # raises the more precise error if the world changed
            raise ValueError(f'{self.name}: {name}: {said}')
        left = self._asked + self._options.patience - now
        if left <= 0:
            raise SimulatorBusy(f'{self.name}: {name}: {said}')
        if not self._warned:
            self._warned = True
            self._node.get_logger().warning(f'{self.name}: {name}: {said}; waiting')
        self._begin_call(command, now + min(_BUSY_RETRY, left))
        return False

    def _poll_description(self) -> bool:
        """Enter the session that a reset or restore drew, once its description has arrived.

        Any other message on `world` means a restart. If another reset follows at once, the
        description never arrives.
        """
        response = self._answer
        self._reconsider()
        if self.world is None or self.world.session != response.session:
            self._next = self._described_by
            if time.monotonic() < self._described_by:
                return False
            raise EnvironmentRestarted(
                f'no description of session {response.session} arrived: another program resets '
                f'{self.name}, or several simulators share its topics')
        self._described_by = 0.0
        spec = self.adopt_spec()
        self.session, self.step = response.session, response.step
        self._flown_by = self._peer.participant
        command = self._command
        assert isinstance(command, Reset | Restore)
        self._answer = observation_of(
            f'{_name(command)}: observation',
            conversion.from_sequence(response.observation, 'f4'), spec)
        return True

    # Shutdown

    def release(self) -> Callable[[], bool]:
        """Release the simulator for another agent; the returned function tells when it is done."""
        client = self._release
        if not (self._claimed and self._node.context.ok() and client.service_is_ready()):
            return lambda: True
        future = client.call_async(srv.Release.Request(agent=self.agent))
        self.session, self._claimed = 0, False
        return future.done

    def destroy(self) -> None:
        """Destroy publishers, subscriptions and clients."""
        self.drop()
        self._node.destroy_publisher(self._publisher)
        for entity in (self._descriptions.subscription, *self._step_subscriptions,
                       *self._clients.values()):
            entity.destroy()
        self._node.destroy_client(self._release)


def _name(command: Command) -> str:
    """Return the name of the service that handles a command.

    :raises TypeError: for an object that is not a command.
    """
    if not isinstance(command, Reset | Restore | Snapshot):
        raise no_command(command)
    return type(command).__name__.lower()


def difference(ours: WorldSpec, theirs: WorldSpec) -> str:
    """Return the first field in which two worlds differ, with both values."""
    old, new = ({**asdict(spec), **spec.settings} for spec in (ours, theirs))
    name = next(name for name in {**new, **old} if name != 'settings'
                and old.get(name) != new.get(name))
    return f'{name} is {new.get(name)}, expected {old.get(name)}'
