# SPDX-License-Identifier: Apache-2.0
"""The agent's end of the wire: a simulator somewhere, used like a world in this process."""
from __future__ import annotations

import secrets
import time
from dataclasses import asdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs import msg
from rocket_msgs import srv

from rocket_sim_node.wire import messages
from rocket_sim_node.wire import qos
from rocket_sim_node.wire.waiting import Silence
from rocket_sim_node.wire.waiting import Waiter
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import EnvironmentRestarted
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec

_BUSY_RETRY = 0.5
"""s between two tries to take a simulator that another agent flies"""
_RELEASE_TIMEOUT = 1.0
"""s that a farewell may take"""
_DESCRIPTION_TIMEOUT = 5.0
"""s from the answer of a reset to the description of its session"""
_KEEP_PERIOD = 2.0
"""s of silence after which `keep` speaks"""


class SimulatorBusy(RuntimeError):
    """Another agent flies the simulator and does not let go."""


@dataclass(frozen=True)
class ClientOptions:
    """How a client waits."""

    resend_after: float = 0.2
    """s without an answer after which an action is sent again; doubled each time, up to 1.6 s"""
    patience: float = 60.0
    """s without an answer after which the client gives up"""


class Client:
    """A simulator as a `VectorEnv`: resets, steps, re-sends, and says when it restarted.

    It spins `executor` only while it waits, in the thread that calls it, so that the other
    callbacks of the node are served in between and nothing is nested.
    """

    def __init__(
        self,
        node: Node,
        executor: Executor,
        options: ClientOptions | None = None,
        agent: int | None = None,
    ) -> None:
        """Advertise; `connect`, `reset` or `restore` come next.

        :param agent: identity, 1 to 2**64 - 1. One that comes back under the same identity may
            go on at once; None draws a new one.
        """
        self._node = node
        self._options = options or ClientOptions()
        self._waiter = Waiter(node, executor, self._options.patience)
        self._agent = agent or secrets.randbits(63) + 1
        self._world: msg.World | None = None
        self._spec: WorldSpec | None = None
        self._session = 0
        self._step = 0
        self._observation: msg.Observation | None = None
        self._reward: msg.Reward | None = None
        self._episodes: msg.Episodes | None = None
        self._message = msg.Action(agent=self._agent)
        self._view: NDArray[Any] = np.zeros(0)
        self.resent = 0
        self._spoke = 0.0
        self._publisher = node.create_publisher(msg.Action, 'action', qos.STREAM)
        self._subscriptions = [
            node.create_subscription(msg.World, 'world', self._on_world, qos.WORLD),
            node.create_subscription(
                msg.Observation, 'observation', self._on_observation, qos.STREAM),
            node.create_subscription(msg.Reward, 'reward', self._on_reward, qos.STREAM),
            node.create_subscription(msg.Episodes, 'episodes', self._on_episodes, qos.EVENTS),
        ]
        self._clients = {
            name: node.create_client(kind, name) for name, kind in (
                ('reset', srv.Reset), ('snapshot', srv.Snapshot), ('restore', srv.Restore),
                ('release', srv.Release))
        }

    def __enter__(self) -> Client:
        """Use as a context that lets go of the simulator at the end."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go."""
        self.close()

    # VectorEnv

    @property
    def spec(self) -> WorldSpec:
        """The world at the far end; waits for it the first time.

        :raises WireTimeout: when no simulator shows up.
        """
        return self._spec or self.connect()

    def connect(self) -> WorldSpec:
        """Wait for a simulator and return what it is.

        :raises WireTimeout: when none shows up.
        """
        self._waiter.wait(lambda: self._world is not None, 'a description')
        assert self._world is not None
        return self._adopt_spec(self._world)

    def reset(self, seed: int | None = None, **settings: float) -> F32:
        """Begin new episodes; see :class:`VectorEnv`.

        :raises WireTimeout: when there is no answer.
        :raises SimulatorBusy: when another agent keeps it.
        """
        response = self._call('reset', srv.Reset.Request(
            agent=self._agent, seed=-1 if seed is None else seed,
            settings=messages.settings_to_message(settings)))
        return self._begin_session(response)

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by one step, exactly once, whatever gets lost on the way.

        With a simulator in real time it waits for the next step instead, whichever that is.

        :raises ValueError: for bad actions; nothing was sent.
        :raises EnvironmentRestarted: when the simulator is in another session.
        :raises WireTimeout: when there is no answer.
        """
        self._view[:] = checked_action(self.spec, action).ravel()
        self._message.session = self._session
        self._message.step = self._step
        self._publisher.publish(self._message)
        silence = Silence(self._node, 'an observation', self._options.patience)
        pause = self._options.resend_after
        resend = time.monotonic() + pause
        while not self._answered():
            self._waiter.spin(resend - time.monotonic())
            self._check_session()
            if time.monotonic() >= resend:
                silence.check()
                self.resent += 1
                self._publisher.publish(self._message)
                pause = min(2 * pause, 8 * self._options.resend_after)
                resend = time.monotonic() + min(pause, silence.left)
        return self._take_answer()

    def snapshot(self) -> bytes:
        """Return the exact state of all rockets; see :class:`VectorEnv`.

        :raises EnvironmentRestarted: when the simulator is in another session.
        :raises WireTimeout: when there is no answer.
        """
        return bytes(self._call('snapshot', srv.Snapshot.Request(
            agent=self._agent, session=self._session, step=self._step)).state)

    def restore(self, state: bytes) -> F32:
        """Put all rockets back into a snapshot; see :class:`VectorEnv`."""
        request = srv.Restore.Request(agent=self._agent)
        request.state = messages.to_sequence(np.frombuffer(state, np.uint8), 'u1')
        return self._begin_session(self._call('restore', request))

    @property
    def session(self) -> int:
        """The session that this client flies in; 0 outside of one."""
        return self._session

    @property
    def realtime(self) -> bool:
        """Whether the simulator goes by the clock; known once connected."""
        return self._world is not None and self._world.mode == msg.World.REALTIME

    def keep(self) -> None:
        """Remind the simulator of its agent while that one computes; call it often.

        The last action sent again changes nothing and is heard.
        """
        now = time.monotonic()
        if self._step > 0 and now - self._spoke > _KEEP_PERIOD:
            self._spoke = now
            self._publisher.publish(self._message)

    def close(self) -> None:
        """Let go of the simulator, so that another agent need not wait."""
        client = self._clients['release']
        if self._session and self._node.context.ok() and client.service_is_ready():
            future = client.call_async(srv.Release.Request(agent=self._agent))
            self._waiter.linger(future.done, _RELEASE_TIMEOUT)
        self._session = 0

    # Sessions

    def _adopt_spec(self, world: msg.World) -> WorldSpec:
        """Take the shape of the world and size the action message for it."""
        spec = messages.world_from_message(world)
        if spec == self._spec:
            return spec
        if self._spec is not None:
            raise ValueError(
                f'simulator came back as another world: {_difference(self._spec, spec)}')
        self._spec = spec
        field, kind = ('continuous', 'f4') if spec.continuous else ('discrete', 'i4')
        self._message = msg.Action(agent=self._agent)
        self._view = messages.shared_view(
            self._message, field, spec.num_envs * spec.action_size, kind)
        return spec

    def _begin_session(self, response: Any) -> F32:
        """Go on in the session that a reset or restore drew."""
        self._observation = self._reward = self._episodes = None
        # The world's description of this session: what else comes on `world` is a restart.
        # When another reset follows at once, it never comes.
        if not self._waiter.until(
                lambda: self._world is not None and self._world.session == response.session,
                _DESCRIPTION_TIMEOUT):
            raise EnvironmentRestarted(
                f'session {response.session:016x} was not described: somebody else resets the '
                'simulator, or several simulators share its topics')
        assert self._world is not None
        self._session = response.session
        self._step = response.step
        spec = self._adopt_spec(self._world)
        observation: F32 = messages.from_sequence(response.observation, 'f4').reshape(
            spec.num_envs, spec.observation_size)
        return observation

    def _check_session(self) -> None:
        """Raise when the simulator has said that it is in a session that is not ours."""
        if self._world is not None and self._world.session != self._session:
            raise EnvironmentRestarted(
                f'simulator is in session {self._world.session:016x}, '
                f'expected {self._session:016x}')

    def _call(self, name: str, request: Any) -> Any:
        """Call a service and return its answer when it is a good one; wait while it is busy."""
        patience = time.monotonic() + self._options.patience
        warned = False
        while True:
            response = self._waiter.call(self._clients[name], request)
            if response.code == response.OK:
                return response
            if name == 'snapshot':
                # Refused for the session: the simulator is not where we believe it to be.
                raise EnvironmentRestarted(f'snapshot: {response.message}')
            if response.code != response.BUSY:
                raise ValueError(f'{name}: {response.message}')
            if time.monotonic() > patience:
                raise SimulatorBusy(f'{name}: {response.message}')
            if not warned:
                warned = True
                self._node.get_logger().warning(f'{name}: {response.message}; waiting')
            self._waiter.until(lambda: False, _BUSY_RETRY)

    # Answers

    def _on_world(self, message: msg.World) -> None:
        self._world = message

    def _on_observation(self, message: msg.Observation) -> None:
        if self._is_awaited(message):
            self._observation = message

    def _on_reward(self, message: msg.Reward) -> None:
        if self._is_awaited(message):
            self._reward = message

    def _on_episodes(self, message: msg.Episodes) -> None:
        if self._is_awaited(message):
            self._episodes = message

    def _is_awaited(self, message: Any) -> bool:
        """Tell whether a message answers the action under way; in real time a later one does."""
        if message.session != self._session:
            return False
        if self.realtime:
            return bool(message.step > self._step)
        return bool(message.step == self._step + 1)

    def _answered(self) -> bool:
        """Tell whether all that belongs to the step has come, the episodes that ended included."""
        if self._observation is None or self._reward is None:
            return False
        step = self._reward.step
        if self._observation.step != step:
            return False
        return not len(self._reward.final_rows) or (
            self._episodes is not None and self._episodes.step == step)

    def _take_answer(self) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        spec, reward = self.spec, self._reward
        assert reward is not None and self._observation is not None
        _check_answer(spec, self._observation, reward)
        observation = messages.from_sequence(self._observation.data, 'f4').reshape(
            spec.num_envs, spec.observation_size)
        finished = messages.from_sequence(reward.final_rows, 'u4').astype(np.int64)
        episodes: Episodes = NO_EPISODES
        if finished.size and self._episodes is not None:
            episodes = messages.episodes_from_message(self._episodes)
        info = {
            'final_rows': finished,
            'final_observation': messages.from_sequence(reward.final_observation, 'f4').reshape(
                len(finished), spec.observation_size),
            'episodes': episodes,
        }
        self._step = reward.step
        self._spoke = time.monotonic()
        self._observation = self._reward = self._episodes = None
        return (
            observation, messages.from_sequence(reward.reward, 'f4'),
            messages.from_sequence(reward.terminated, 'u1').view(np.bool_),
            messages.from_sequence(reward.truncated, 'u1').view(np.bool_), info,
        )


def _difference(ours: WorldSpec, theirs: WorldSpec) -> str:
    """Return in which field two worlds differ, and how."""
    old, new = ({**asdict(spec), **spec.settings} for spec in (ours, theirs))
    name = next(name for name in {**new, **old} if name != 'settings'
                and old.get(name) != new.get(name))
    return f'{name} is {new.get(name)}, expected {old.get(name)}'


def _check_answer(spec: WorldSpec, observation: msg.Observation, reward: msg.Reward) -> None:
    """Check what came from the far end before anything is learnt from it.

    :raises ValueError: naming topic, field, what came and what was expected.
    """
    finished = len(reward.final_rows)
    for where, values, expected in (
        ('observation: data', observation.data, spec.num_envs * spec.observation_size),
        ('reward: reward', reward.reward, spec.num_envs),
        ('reward: terminated', reward.terminated, spec.num_envs),
        ('reward: truncated', reward.truncated, spec.num_envs),
        ('reward: final_observation', reward.final_observation,
         finished * spec.observation_size),
    ):
        if len(values) != expected:
            raise ValueError(f'{where}: {len(values)} values, expected {expected}')
    if finished and max(reward.final_rows) >= spec.num_envs:
        raise ValueError(
            f'reward: final_rows: {max(reward.final_rows)}, expected less than {spec.num_envs}')
    for where, values in (
            ('observation: data', observation.data), ('reward: reward', reward.reward)):
        if not np.isfinite(messages.from_sequence(values, 'f4')).all():
            raise ValueError(f'{where}: a value that is not finite')
