# SPDX-License-Identifier: Apache-2.0
"""The wire between clients in this process and one simulator, which all of these tests share."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_hash import TypeHash
from rocket_msgs import msg
from support.nodes.speaker import Speaker
from support.processes import Process
from support.processes import Processes
from support.training.rollouts import assert_same
from support.training.rollouts import random_actions

from rocket_sim_node.telemetry.gaps import GapCounter
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.definitions import DefinitionsDiffer
from rocket_sim_node.wire.messages.definitions import hashes
from rocket_sim_node.worlds import make

N = 8
MakeClient = Callable[..., Client]
actions = partial(random_actions, N)


@pytest.fixture(scope='module')
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """Processes that end with the last test."""
    group = Processes(tmp_path_factory.mktemp('wire'))
    yield group
    group.end()


@pytest.fixture(scope='module')
def simulator(processes: Processes) -> Process:
    """A simulator of N rockets, level 7."""
    return processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)


@pytest.fixture
def make_client(make_client: MakeClient) -> Iterator[MakeClient]:
    """Clients that release control at the end of the test, so that the next one can take it."""
    clients = []

    def make(**options: Any) -> Client:
        clients.append(make_client(**options))
        return clients[-1]

    yield make
    for client in clients:
        client.close()


@pytest.fixture(autouse=True)
def running(simulator: Process) -> Iterator[None]:
    """Whatever a test sends, the simulator is there for the next one."""
    yield
    assert simulator.running, simulator.output()


@pytest.mark.parametrize(('buffer', 'acknowledged'), [
    (8 * N * 70 - 1, True), (8 * N * 70, False), (None, False)])
def test_observations_too_large_for_a_socket_are_acknowledged(
        simulator: Process, make_client: MakeClient, monkeypatch: pytest.MonkeyPatch,
        buffer: int | None, acknowledged: bool) -> None:
    monkeypatch.setattr(qos, 'receive_buffer', lambda: buffer)
    monkeypatch.setattr(qos, 'set_up_by_user', lambda: False)
    client, world = make_client(), make('rocket', N, 1)
    np.testing.assert_array_equal(client.reset(1), world.reset(1))
    for action in actions(5):
        assert_same(client.step(action), world.step(action))

    def reliability() -> list[ReliabilityPolicy]:
        return [info.qos_profile.reliability for topic in ('observation', 'reward')
                for info in client.node.get_subscriptions_info_by_topic(topic)]

    wanted = 2 * [ReliabilityPolicy.RELIABLE if acknowledged else ReliabilityPolicy.BEST_EFFORT]
    assert client.waiter.until(lambda: reliability() == wanted, 5.0), reliability()


def test_same_rollout_in_process_and_over_dds(
        simulator: Process, make_client: MakeClient) -> None:
    client = make_client()
    world = make('rocket', num_envs=N, seed=3)
    np.testing.assert_array_equal(client.reset(11, level=5), world.reset(11, level=5))
    episodes = 0
    for action in actions(700):
        ours, theirs = client.step(action), world.step(action)
        assert_same(ours, theirs)
        episodes += len(ours[4]['episodes'])
    assert episodes > 10
    state = client.snapshot()
    assert state == world.snapshot()
    first = client.step(actions(1)[0])
    client.restore(state)
    assert_same(client.step(actions(1)[0]), first)
    assert client.spec == world.spec


def test_repeated_action_is_answered_again_and_steps_once(
        simulator: Process, make_client: MakeClient) -> None:
    client = make_client()
    client.reset(1)
    speaker = Speaker(client)
    values = actions(1)[0]
    world = make('rocket', num_envs=N)
    world.reset(1)
    for expected in (1, 2, 3):
        speaker.say(values, step=0)
        speaker.insist(lambda: len(speaker.heard) >= expected)  # noqa: B023
    assert {step for _, step in speaker.heard} == {1}
    client.connection.step = 1
    world.step(values)
    assert_same(client.step(values), world.step(values))


@pytest.mark.parametrize(('fields', 'words'), [
    ({'session': 12345}, ('action: session', '12345')),
    ({'step': 7}, ('action: step: 7', 'expected 0')),
    ({'agent': 99}, ('action: agent', '99')),
])
def test_foreign_early_and_stale_actions_change_nothing(
        simulator: Process, make_client: MakeClient, fields: dict, words: tuple) -> None:
    client = make_client()
    client.reset(1)
    speaker = Speaker(client)
    speaker.say(actions(1)[0], **fields)
    speaker.expect_refusal(*words)
    world = make('rocket', num_envs=N)
    world.reset(1)
    assert_same(client.step(actions(1)[0]), world.step(actions(1)[0]))


@pytest.mark.parametrize(('values', 'words'), [
    (np.full((N, 3), np.nan), ('action: row 0', "'throttle' is nan")),
    (np.where(np.arange(3 * N).reshape(N, 3) == 16, np.inf, 0.0), ('row 5', "'rcs_x' is inf")),
    (np.zeros((N - 1, 3)), ('continuous: 21 values', 'expected 24')),
    (np.zeros(0), ('continuous: 0 values', 'expected 24')),
])
def test_bad_actions_are_named_and_change_nothing(
        simulator: Process, make_client: MakeClient, values: np.ndarray, words: tuple) -> None:
    client = make_client()
    client.reset(1)
    speaker = Speaker(client)
    speaker.say(values)
    speaker.expect_refusal(*words)
    assert not speaker.heard
    world = make('rocket', num_envs=N)
    world.reset(1)
    assert_same(client.step(actions(1)[0]), world.step(actions(1)[0]))


def test_client_refuses_bad_actions_itself(
        simulator: Process, make_client: MakeClient) -> None:
    client = make_client()
    client.reset(1)
    with pytest.raises(ValueError, match="row 2, 'rcs_z' is nan"):
        client.step(np.where(np.arange(3 * N).reshape(N, 3) == 8, np.nan, 0.0))
    with pytest.raises(ValueError, match='shape'):
        client.step(np.zeros((N, 2)))
    client.step(np.zeros((N, 3)))


@pytest.mark.parametrize(('seed', 'settings', 'words'), [
    (-5, {}, 'seed: got -5, expected a whole number from 0 to'),
    (0, {'level': 9}, 'level: got 9.0, expected 1 to 8'),
    (0, {'gravity': 1.0}, "unknown setting 'gravity'"),
    (0, {'spawn_speed': float('nan')}, 'spawn_speed: got nan'),
])
def test_bad_resets_are_named_and_change_nothing(
        simulator: Process, make_client: MakeClient, seed: int, settings: dict,
        words: str) -> None:
    client = make_client()
    client.reset(4, level=3)
    world = make('rocket', num_envs=N)
    world.reset(4, level=3)
    for action in actions(3):
        assert_same(client.step(action), world.step(action))
    session = client.connection.session
    with pytest.raises(ValueError, match=words):
        client.reset(seed, **settings)
    assert client.connection.session == session
    assert_same(client.step(actions(1)[0]), world.step(actions(1)[0]))


def test_damaged_snapshot_is_refused(simulator: Process, make_client: MakeClient) -> None:
    client = make_client()
    client.reset(4)
    client.step(actions(1)[0])
    state = client.snapshot()
    for damaged in (b'', b'nonsense', state[:-20], make('rocket', num_envs=3).snapshot()):
        with pytest.raises(ValueError, match='snapshot'):
            client.restore(damaged)
    assert client.snapshot() == state
    client.step(actions(1)[0])


def test_a_second_agent_is_refused_until_the_first_releases_control(
        simulator: Process, make_client: MakeClient) -> None:
    first = make_client()
    second = make_client(patience=5.0)
    first.reset(1)
    with pytest.raises(SimulatorBusy, match='controls this simulator'):
        second.reset(2)
    world = make('rocket', num_envs=N)
    world.reset(1)
    assert_same(first.step(actions(1)[0]), world.step(actions(1)[0]))
    first.close()
    second.reset(2)
    second.step(actions(1)[0])
    second.close()


def test_the_same_agent_can_take_control_again_at_once(
        simulator: Process, make_client: MakeClient) -> None:
    first = make_client(agent=42)
    first.reset(1)
    state = first.snapshot()
    again = make_client(agent=42, patience=8.0)
    again.restore(state)
    again.step(actions(1)[0])


def test_discovery_shows_equal_definition_hashes_at_both_ends(
        simulator: Process, make_client: MakeClient) -> None:
    """Without the hashes, no other definition would be refused."""
    client = make_client()
    client.connect()
    node = client.node
    for topic in ('world', 'observation', 'reward', 'episodes'):
        assert client.waiter.until(partial(node.count_publishers, topic), 10.0)
        near = hashes(node.get_subscriptions_info_by_topic(topic))
        far = hashes(node.get_publishers_info_by_topic(topic))
        assert {hash_ for _, hash_ in near} == {hash_ for _, hash_ in far} != set()
        assert node.get_fully_qualified_name() in {name for name, _ in near}


@pytest.mark.parametrize('hidden', [0, 1, 2], ids=['at once', 'at the reset', 'at the first step'])
@pytest.mark.parametrize('topic', ['reward', 'episodes'])
def test_a_simulator_built_from_another_definition_is_refused(
        simulator: Process, make_client: MakeClient, monkeypatch: pytest.MonkeyPatch,
        topic: str, hidden: int) -> None:
    """It does not matter how late the topic with the difference is discovered."""
    client = make_client()
    real = client.node.get_publishers_info_by_topic
    # The name of a publisher's node is discovered after the publisher.
    assert client.waiter.until(
        lambda: 'simulator' in {end.node_name for end in real(topic)}, 10.0)
    looks = 0

    def as_of_another_build(name: str, *more: bool) -> list[TopicEndpointInfo]:
        nonlocal looks
        ends = real(name, *more)
        if name.endswith(topic):
            looks += 1
            if looks <= hidden:
                return []
            for end in ends:
                end.topic_type_hash = TypeHash(1, bytes(32))
        return ends

    monkeypatch.setattr(client.node, 'get_publishers_info_by_topic', as_of_another_build)
    flight = [client.connect, lambda: client.reset(0), lambda: client.step(actions(1)[0])]
    for flies in flight[:hidden]:
        flies()
    with pytest.raises(DefinitionsDiffer, match=f'{topic}: /simulator defines its messages as'):
        flight[hidden]()


def test_the_description_holds_the_settings_flown_and_those_replaced(
        simulator: Process, make_client: MakeClient) -> None:
    client, late = make_client(), make_client()
    described: list[msg.World] = []

    def level(number: int, replaced: dict[str, float]) -> None:
        """Wait for the description of the session, as a late joiner."""
        described.clear()
        listener = late.node.create_subscription(
            msg.World, 'world', described.append, qos.WORLD)
        assert late.waiter.until(lambda: bool(described) and (
            described[-1].session == client.session), 10.0)
        late.node.destroy_subscription(listener)
        message = described[-1]
        assert conversion.settings_from_message(message.settings)['level'] == number
        assert conversion.settings_from_message(message.replaced) == replaced

    client.reset(3)
    level(7, {})
    client.reset(3, level=1)
    state = client.snapshot()
    level(1, {'level': 7})
    # To an agent it is the simulator that it was.
    assert late.connect() == client.spec == make('rocket', num_envs=N).spec
    client.reset(3)
    level(7, {})
    client.restore(state)
    level(1, {'level': 7})


def test_a_listener_counts_the_messages_it_missed(
        simulator: Process, make_client: MakeClient) -> None:
    client, listener = make_client(), make_client()
    client.reset(1)
    stalled, deep = GapCounter(), GapCounter()
    noted: list[int] = []

    def note(counter: GapCounter, message: msg.Observation) -> None:
        counter.note(message.session, message.step)
        if counter is stalled:
            noted.append(message.step)

    for counter, depth in ((stalled, qos.STREAM.depth), (deep, 100)):
        listener.node.create_subscription(
            msg.Observation, 'observation', partial(note, counter),
            QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE))

    def fly(steps: int) -> None:
        for action in actions(steps):
            client.step(action)

    heard: list[int] = []
    listener.node.create_subscription(
        msg.Observation, 'observation', lambda m: heard.append(m.step), qos.STREAM)
    while not heard:  # the simulator knows its listeners
        fly(1)
        listener.waiter.spin(0.05)
    listener.waiter.until(lambda: heard[-1] == client.connection.step, 5.0)
    listener.waiter.linger(lambda: False, 0.2)  # the counters have heard it, too
    before = client.connection.step
    fly(50)  # the listener is not spun meanwhile
    listener.waiter.until(
        lambda: heard[-1] == client.connection.step and stalled.missed > 0, 5.0)
    listener.waiter.linger(lambda: False, 0.2)
    assert client.connection.step == before + 50
    # Its history holds fewer than 50; on a busy machine some arrive only while it reads.
    assert 0 < stalled.missed == 50 - sum(step > before for step in noted)
    assert deep.missed == 0
