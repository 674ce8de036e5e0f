# SPDX-License-Identifier: Apache-2.0
"""Messages forged in the name of the agent or the simulator do not change what is learnt.

The forger answers at once: mostly before the node that it imitates.
"""
from __future__ import annotations

import itertools
import re
import time
from collections.abc import Callable
from importlib.metadata import version
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from rocket_msgs import msg
from rocket_msgs import srv
from support.processes import Processes
from support.training.rollouts import assert_same

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.wire.node import peer
from rocket_sim_node.wire.server import duplicate_simulators
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import make

CODEC = Codec(msg.Action)
N, STEPS, PERIOD = 8, 60, 20
UNREAD = ('state', 'training')
"""kinds that neither side reads"""
SERVICES = '/simulator/(reset|restore|snapshot)'

pytestmark = pytest.mark.skipif(
    int(version('rclpy').split('.')[0]) < 9, reason="Jazzy's rclpy tells no writer")


class Errors:
    """Receives the errors on `/diagnostics`."""

    def __init__(self, client: Client) -> None:
        self.texts: set[str] = set()
        self.counts: dict[str, dict[str, str]] = {}
        client.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.EVENTS)
        # An error is published once, so the node that reports it must have found this listener.
        assert client.waiter.until(lambda: 'simulator' in self.counts, 10.0)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        status = message.status[0]
        self.counts[status.hardware_id] = {item.key: item.value for item in status.values}
        if status.level == DiagnosticStatus.ERROR:
            self.texts.add(status.message)


def test_forgeries_are_dropped_counted_and_reported(
        processes: Processes, make_client: Callable[..., Client]) -> None:
    """Under forgeries of each kind, a client's flight equals that in process, bit for bit."""
    simulator = processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client, world, rng = make_client(), make('rocket', num_envs=N), np.random.default_rng(1)
    errors = Errors(client)

    def fly(kinds: tuple[str, ...]) -> None:
        known = set(errors.texts)
        forger = processes.start(
            'python', '-m', 'support.invalid_data.forger', '--ros-args',
            '-p', f'kinds:={",".join(kinds)}')
        forger.wait_for('forging', 30.0)
        end = time.monotonic() + 30.0
        missing = {SERVICES if kind == 'services' else f'/?{kind}' for kind in kinds
                   if kind not in {*UNREAD, 'flood'}}
        for number in itertools.count():
            if not number % PERIOD:
                np.testing.assert_array_equal(client.reset(number), world.reset(number))
            action = rng.uniform(-1, 1, (N, 3)).astype(np.float32)
            assert_same(client.step(action), world.step(action))
            if number % PERIOD == 10:
                state = client.snapshot()
                assert state == world.snapshot()
            if number % PERIOD == 15:
                np.testing.assert_array_equal(client.restore(state), world.restore(state))
            missing -= {topic for topic in missing if any(
                re.match(rf'{topic}: .*/forger', text) for text in errors.texts - known)}
            if number > STEPS and not missing:
                break
            assert time.monotonic() < end, f'not told: {missing}; told: {errors.texts}'
        assert client.snapshot() == world.snapshot()
        forger.end()
        for kind in kinds:
            (sent,) = re.findall(rf"'{kind}': (\d+)", forger.output())
            assert int(sent) > 0, kind

    fly(('action', 'flood'))
    assert client.messages_dropped == 0
    assert int(errors.counts['simulator']['dropped on action']) > 0
    fly(('reward', 'observation', 'episodes', *UNREAD))
    before = client.messages_dropped
    assert before > 0
    fly(('world', 'services'))
    assert client.messages_dropped > before
    errors_logged = re.findall(r'\[ERROR\].*', simulator.output())
    # Once for each of the three forgers and each of their topics; those of services come and go.
    assert len(errors_logged) == len(set(errors_logged))
    assert ['/forger (GID ' in error for error in errors_logged] == [True] * len(errors_logged)


def test_an_agent_reports_that_its_simulator_ran_ahead(
        processes: Processes, make_client: Callable[..., Client]) -> None:
    """The extra actions come from the agent's own participant, so they are accepted."""
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client = make_client()
    client.reset(1)
    still = np.zeros((N, 3), np.float32)
    client.step(still)
    publisher = client.node.create_publisher(msg.Action, 'action', qos.STREAM)
    heard = [1]
    client.node.create_subscription(
        msg.Observation, 'observation', lambda message: heard.append(message.step), qos.STREAM)
    assert client.waiter.until(lambda: publisher.get_subscription_count() > 0, 10.0)
    connection = client.connection
    for step in (1, 2, 3):
        message = CODEC.encode((client.session, step, connection.agent), (still, np.zeros(0)))

        def flown(step: int = step, message: bytes = message) -> bool:
            publisher.publish(message)
            return step + 1 in heard

        assert client.waiter.until(flown, 10.0)
    connection.listen()
    with pytest.raises(EnvironmentRestarted, match=(
            rf'simulator is at step 4, expected 2: another node sends actions as agent '
            rf'{connection.agent}; other writers of /action: none')):
        client.step(still)


@pytest.mark.parametrize('below', ['/simulator/', '/'])
def test_calls_in_the_name_of_the_agent_are_refused_and_reported(
        processes: Processes, make_client: Callable[..., Client],
        make_node: Callable[..., Any], below: str) -> None:
    """The calls carry the identity and the GID of the agent, which are public.

    This holds for the deprecated names of services, too, for which the agent has no client.
    """
    simulator = processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client, world = make_client(), make('rocket', num_envs=N)
    errors = Errors(client)
    client.reset(1)
    world.reset(1)
    still = np.zeros((N, 3), np.float32)
    node, executor = make_node('/forger')
    agent, writer = client.connection.agent, list(client.connection._writer)
    calls = {
        'snapshot': srv.Snapshot.Request(agent=agent, session=client.connection.session, step=1),
        'reset': srv.Reset.Request(agent=agent, writer=writer, seed=2),
        'restore': srv.Restore.Request(agent=agent, writer=writer, state=list(client.snapshot())),
        'release': srv.Release.Request(agent=agent)}
    for name, request in calls.items():
        caller = node.create_client(getattr(srv, name.title()), f'{below}{name}')
        assert client.waiter.until(caller.service_is_ready, 10.0)
        assert_same(client.step(still), world.step(still))  # the agent is there
        future = caller.call_async(request)
        executor.spin_until_future_complete(future, 10.0)
        assert future.result().code == future.result().BUSY
        assert 'another process controls this simulator' in future.result().message
        assert_same(client.step(still), world.step(still))
        # At once, even where its node's name has not arrived yet.
        refusal = re.compile(
            rf'{name}: (/forger/tester|a participant whose node is not known) '
            rf'\(GID [0-9a-f.]+, on this machine\) calls as agent {agent}, which is another '
            'participant: refused')
        assert client.waiter.until(
            lambda refusal=refusal: any(map(refusal.match, errors.texts)), 30.0)
        assert int(errors.counts['simulator'][f'dropped on {name}']) == 1
    assert simulator.output().count('ERROR') == len(calls)
    client.close()
    make_client(patience=2.0).reset(3)


def test_an_agent_reports_that_it_was_replaced_while_silent(
        processes: Processes, make_client: Callable[..., Client]) -> None:
    """A sender with the agent's identity may be the restarted agent, so it is accepted."""
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client, again = make_client(agent=5), make_client(agent=5)
    errors = Errors(again)
    client.reset(1)
    again.reset(2)  # is refused until the first has been silent for long enough
    with pytest.raises(EnvironmentRestarted, match='it was reset by another program'):
        client.step(np.zeros((N, 3), np.float32))
    assert again.waiter.until(lambda: any(
        'acts as agent 5, which is another participant' in text for text in errors.texts), 10.0)


@pytest.mark.parametrize('others', [0, 1, 2])
def test_a_node_knows_its_own_writer_when_others_of_its_name_appear(
        monkeypatch: pytest.MonkeyPatch, others: int) -> None:
    """Two simulators that start at once: each must know which messages are not its own."""
    there: dict[bytes, str] = {}
    made: list[bytes] = []

    def create(*_: Any) -> bytes:
        made.append(b'own %d' % len(made))
        there[made[-1]] = '/space/simulator'
        if len(made) <= others:
            there[b'other %d' % len(made)] = '/space/simulator'
        there[b'third %d' % len(made)] = '/space/recorder'
        return made[-1]

    monkeypatch.setattr(peer, 'writers', lambda *_: dict(there))
    node: Any = SimpleNamespace(
        get_namespace=lambda: '/space', get_name=lambda: 'simulator', create_publisher=create,
        destroy_publisher=there.pop)
    found = peer.known_publisher(node, msg.World, 'world', qos.WORLD)
    assert found == (made[-1], made[-1])
    assert len(made) == 1 + others
    assert len([gid for gid in there if gid.startswith(b'own')]) == 1


def test_a_second_simulator_is_reported_once_the_graph_lists_it(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Its one message may come earlier; and it is forgotten when it has gone."""
    gid, arrived = bytes(range(16)), list[Any]()
    listed, faults = dict[bytes, str](), list[str]()
    monkeypatch.setattr(duplicate_simulators, 'MessageSubscription', lambda *_: SimpleNamespace(
        take=lambda: arrived.pop() if arrived else None))
    monkeypatch.setattr(duplicate_simulators, 'writers', lambda *_: listed)
    node: Any = None
    namer: Any = SimpleNamespace(named=lambda *_: '/other')
    health: Any = SimpleNamespace(fault=lambda *given: faults.append(given[2]()))
    watch = duplicate_simulators.DuplicateDetector(node, namer, health, bytes(12))
    arrived.append((None, gid))
    watch.look()
    assert not faults
    listed[gid] = '/other'
    watch.look()
    assert len(faults) == 1 and faults[0].startswith('world: /other also describes a world')
    listed.clear()
    watch.look()
    listed[gid] = '/other'
    watch.look()
    assert len(faults) == 1


def test_a_second_simulator_on_the_same_topics_is_reported_by_all(
        processes: Processes, make_client: Callable[..., Client]) -> None:
    first, second = (
        processes.fork_node('rocket_sim_node', 'simulator', num_envs=N) for _ in range(2))
    for node in (first, second):
        node.wait_for('namespace of its own', 20.0)
        assert re.search(
            r'world: /simulator \(GID [0-9a-f.]+, on this machine\) also describes a world on '
            r'this topic; give each simulator a namespace of its own', node.output())
    client = make_client()
    errors = Errors(client)

    def all_tell() -> bool:
        client.reset(1)
        return all(any(said in text for text in errors.texts) for said in (
            'world on this topic; give', 'topic: ignored, because /simulator (GID'))

    assert client.waiter.until(all_tell, 20.0), errors.texts
    assert int(errors.counts['simulator']['second simulator seen']) > 0
    assert first.output().count('ERROR') == 1, 'told once'
