# SPDX-License-Identifier: Apache-2.0
"""The bag recorder as a process: bags are complete, and lost messages are reported."""
from __future__ import annotations

import re
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message
from rclpy.type_hash import TypeHash
from rocket_msgs import msg
from rosbags.highlevel import AnyReader
from std_msgs.msg import String
from support.nodes.falling_rockets import FALL
from support.nodes.falling_rockets import Simulator
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

from rocket_sim_node.bags.bag_file import FLUSH
from rocket_sim_node.bags.bag_file import Salvage
from rocket_sim_node.bags.definitions import type_hash
from rocket_sim_node.bags.reader import messages
from rocket_sim_node.bags.reader import read
from rocket_sim_node.nodes.bag_recorder import BagNode
from rocket_sim_node.wire.dds import qos

SESSIONS = 3
STEPS = 300


def start(processes: Processes, path: Path, **parameters: object) -> Process:
    recorder = processes.fork_node('rocket_sim_node', 'bag_recorder', output=path, **parameters)
    recorder.wait_for('recording to', 20.0)
    return recorder


def stop(recorder: Process) -> str:
    recorder.signal(signal.SIGTERM)
    assert recorder.wait(30.0) == 0
    assert 'Traceback' not in recorder.output()
    return recorder.output()


def partial_file(bag: Path) -> Path:
    """Return the file of a bag that is being recorded."""
    return bag.with_name(f'{bag.name}.partial') / f'{bag.name}_0.mcap'


def written(bag: Path) -> set[str]:
    """Return the topics with a message in a bag that is being recorded."""
    partial = partial_file(bag)
    return {topic.name for topic, _, _ in Salvage(partial)} if partial.exists() else set()


def wait_until_written(bag: Path) -> None:
    """Wait until a bag being recorded has all of a fall: nothing came for several flushes."""
    partial = partial_file(bag)
    wait_until(lambda: partial.exists() and partial.stat().st_size > 10_000
               and time.time() - partial.stat().st_mtime > 3 * FLUSH, 60.0)


def test_the_bag_holds_every_observation(
    processes: Processes, make_node: Callable[..., Any], make_client: Callable[..., Any],
    tmp_path: Path,
) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=8, state_batch=25)
    recorder = start(processes, tmp_path / 'bag')
    client = make_client()
    client.reset(seed=3)
    for topic in ('observation', 'reward', 'action', 'state', 'episodes', 'world'):
        recorder.wait_for(f'recording /{topic} ', 20.0)
    looker, _ = make_node('/looker')
    wait_until(lambda: all(
        len(looker.get_subscriptions_info_by_topic(topic)) >= number
        for topic, number in (('/observation', 2), ('/state', 1))), 20.0)
    # Nothing shows when its readers match both ends. On a busy machine that can take seconds.
    for session in range(SESSIONS):
        time.sleep(1.0 + session)
        observations = [client.reset(seed=4)]
        for _ in range(STEPS):
            observations.append(client.step(np.zeros((8, 3), np.float32))[0])
    digests = {
        topic: str(looker.get_publishers_info_by_topic(topic)[0].topic_type_hash)
        for topic in ('/observation', '/state', '/world')}
    output = stop(recorder)
    assert 'were not received' not in output
    with AnyReader([tmp_path / 'bag']) as bag:
        assert digests.items() <= {one.topic: one.digest for one in bag.connections}.items()
        found = {}
        for connection, _, raw in bag.messages(
                one for one in bag.connections if one.topic == '/observation'):
            one: Any = bag.deserialize(raw, connection.msgtype)
            found[one.session, one.step] = one.data
    sessions = Counter(session for session, _ in found)
    newest = client.session
    assert sessions[newest] == STEPS + 1  # each of a step, and the first one
    for step, observation in enumerate(observations):
        np.testing.assert_array_equal(found[newest, step].reshape(8, -1), observation)
    flights = read(tmp_path / 'bag', rows=[0])
    assert flights
    metadata = yaml.safe_load((tmp_path / 'bag/metadata.yaml').read_text())
    qualities = {
        one['topic_metadata']['name']: one['topic_metadata']['offered_qos_profiles'][0]
        for one in metadata['rosbag2_bagfile_information']['topics_with_message_count']}
    assert qualities['/world']['durability'] == 'transient_local'
    assert qualities['/observation']['durability'] == 'volatile'


def test_chosen_topics_missing_steps_and_a_late_start(
    processes: Processes, simulator: Simulator, tmp_path: Path,
) -> None:
    recorder = start(processes, tmp_path / 'bag', topics='state world')
    recorder.wait_for('recording /state ', 20.0)
    simulator.begin(training=False)
    simulator.fall(100)
    simulator.skip(30)
    simulator.fall(FALL)
    recorder.wait_for('/state: 30 steps before step 131 of session 1 were not received', 20.0)
    late = start(processes, tmp_path / 'late', topics='/wor*')
    late.wait_for('recording /world ', 20.0)
    wait_until(lambda: written(tmp_path / 'late') == {'/world'}, 20.0)
    output = stop(late)
    assert '(1 messages' in output
    assert '/state: 30 steps were not received' in stop(recorder)
    metadata = yaml.safe_load((tmp_path / 'bag/metadata.yaml').read_text())[
        'rosbag2_bagfile_information']
    assert metadata['custom_data'] == {'/state': '30 steps were not received'}
    received = {
        step for one in messages(tmp_path / 'bag', topics=['/state'])
        for step in one.message.step.tolist()}
    assert len(received) + 30 == 1 + 100 + 30 + FALL  # with step 0: none is uncounted
    assert {one['topic_metadata']['name'] for one in metadata['topics_with_message_count']} == {
        '/state', '/world'}


def test_a_new_recorder_repairs_the_bag_of_a_killed_one(
    processes: Processes, simulator: Simulator, tmp_path: Path,
) -> None:
    path = tmp_path / 'bag'
    recorder = start(processes, path, topics='state world')
    recorder.wait_for('recording /state ', 20.0)
    simulator.begin(training=False)
    simulator.fall(FALL + 20)
    wait_until_written(path)
    recorder.signal(signal.SIGKILL)
    recorder.wait(5.0)
    assert not path.exists()
    refused = processes.fork_node('rocket_sim_node', 'bag_recorder', output='/proc/bag')
    again = start(processes, path, topics='state world')
    assert 'its bag is repaired' in again.output()
    assert read(path)[0].outcome == 'too_fast'
    stop(again)
    assert refused.wait(20.0) == 2
    assert "'/proc'" in refused.output()


def test_hidden_topics_are_skipped_and_latched_messages_are_recorded(
    processes: Processes, make_node: Callable[..., Any], tmp_path: Path,
) -> None:
    node, _ = make_node()
    words = node.create_publisher(String, 'words', qos.EVENTS)
    hidden = node.create_publisher(String, '_hidden/words', qos.EVENTS)
    node.create_subscription(String, 'latched', lambda message: None, qos.WORLD)
    recorder = start(processes, tmp_path / 'bag')
    for topic in ('words', 'latched'):
        recorder.wait_for(f'recording /{topic} (std_msgs/msg/String)', 20.0)
    # Whether it matches at once or a moment later, a late joiner gets what is latched.
    latched = node.create_publisher(String, 'latched', qos.WORLD)
    latched.publish(String(data='for late ones'))
    wait_until(lambda: words.get_subscription_count() == 1 and any(
        end.node_name == 'bag_recorder' and end.qos_profile.durability == qos.WORLD.durability
        for end in node.get_subscriptions_info_by_topic('/latched')), 20.0)
    words.publish(String(data='hello'))
    wait_until(lambda: written(tmp_path / 'bag') >= {'/words', '/latched'}, 20.0)
    stop(recorder)
    said = {one.message.data for one in messages(tmp_path / 'bag', topics=['/words', '/latched'])}
    assert said == {'hello', 'for late ones'}
    assert hidden.get_subscription_count() == 0


def test_messages_of_another_definition_are_left_out() -> None:
    said: list[str] = []
    other: Any = SimpleNamespace(
        node_name='old', node_namespace='/', qos_profile=qos.WORLD,
        topic_type='rocket_msgs/msg/World',
        topic_type_hash=TypeHash(version=1, value=bytes(32)))
    node: Any = SimpleNamespace(
        get_topic_names_and_types=lambda: [('/world', ['rocket_msgs/msg/World'])],
        get_publishers_info_by_topic=lambda topic: [other],
        get_logger=lambda: SimpleNamespace(error=said.append))
    bag: Any = SimpleNamespace(tick=lambda: None)
    recorder = BagNode(node, bag, [])
    for _ in range(2):
        recorder.look()
    assert len(said) == 1  # once
    assert re.fullmatch(
        r'/world ignored: its type rocket_msgs/msg/World has the hash RIHS01_0{64}, expected '
        r'RIHS01_\w{64}: its publisher was built from another definition', said[0])


def test_a_topic_is_recorded_again_when_its_other_definition_has_gone() -> None:
    """And what is missing is in the bag at once: a full disk may end it at any message."""
    said: list[str] = []
    subscriptions: list[Any] = []
    diagnostics: dict[str, str] = {}
    written: list[bytes] = []
    kind = 'rocket_msgs/msg/Observation'
    types = [kind]
    ends: list[Any] = []

    def end(value: bytes) -> Any:
        return SimpleNamespace(
            node_name='one', node_namespace='/', qos_profile=qos.STREAM, topic_type=kind,
            topic_type_hash=TypeHash(version=1, value=value))

    def subscribe(kind: Any, topic: str, on_message: Any, *_: Any, **__: Any) -> Any:
        subscriptions.append(on_message)
        return on_message

    node: Any = SimpleNamespace(
        get_topic_names_and_types=lambda: [('/observation', types)],
        get_publishers_info_by_topic=lambda topic: ends,
        count_publishers=lambda topic: len(ends),
        create_subscription=subscribe, destroy_subscription=subscriptions.remove,
        get_logger=lambda: SimpleNamespace(
            error=said.append, info=lambda text: None, warning=lambda text, **_: None))
    bag: Any = SimpleNamespace(
        tick=lambda: None, add_topic=lambda topic: None, tell=diagnostics.__setitem__,
        write=lambda topic, data, *_: written.append(data))
    recorder = BagNode(node, bag, [])
    right, wrong = end(bytes.fromhex(type_hash(kind).removeprefix('RIHS01_'))), end(bytes(32))

    def publish(step: int) -> None:
        data = bytes(serialize_message(msg.Observation(session=1, step=step)))
        for on_message in subscriptions:
            on_message(data)

    recorder.look()  # only subscribers so far
    assert len(subscriptions) == 1
    ends[:] = [wrong]
    publish(1)  # before the next look
    assert not written
    recorder.look()
    assert not subscriptions and len(said) == 1
    ends[:] = [right]
    recorder.look()
    publish(2)
    publish(5)
    assert len(written) == 2
    assert diagnostics == {'/observation': '2 steps were not received'}
    ends[:] = [right, wrong]
    recorder.look()
    assert not subscriptions and len(said) == 2
    ends[:] = [right]
    recorder.look()
    publish(6)
    assert len(written) == 3
    types[:], ends[:] = ['std_msgs/msg/String'], [right, right]
    recorder.look()
    assert said[-1] == (
        f'/observation ignored: its type is now std_msgs/msg/String, expected {kind} as before')
    types[:] = ['std_msgs/msg/String', kind]
    recorder.look()
    publish(7)
    assert len(written) == 4 and len(said) == 3


def test_all_topics_are_recorded_by_the_command_under_any_name(
    processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Names that YAML would read as a number or a truth value."""
    monkeypatch.chdir(tmp_path)
    for name in ('2024', 'true'):
        recorder = processes.start('ros2', 'bag', 'record', '-a', '-o', name)
        recorder.wait_for('recording /rosout ', 20.0)
        recorder.signal(signal.SIGINT)
        assert recorder.wait(30.0) in (0, 130)
        assert f'recording to {name}' in recorder.output()


def test_a_bag_is_shown_and_played_by_the_command(
    processes: Processes, simulator: Simulator, make_node: Callable[..., Any], tmp_path: Path,
) -> None:
    path = tmp_path / 'bag'
    recorder = processes.start('ros2', 'bag', 'record', '-o', str(path), '--topics', '/state',
                               '/world')
    recorder.wait_for('recording /state ', 20.0)
    simulator.begin(training=False)
    simulator.fall(FALL)
    wait_until_written(path)
    recorder.signal(signal.SIGINT)
    assert recorder.wait(30.0) in (0, 130)
    simulator.end()

    info = processes.start('ros2', 'bag', 'info', str(path))
    assert info.wait(20.0) == 0
    for line in ('Files:             bag_0.mcap', 'Storage id:        mcap',
                 'Topic: /state | Type: rocket_msgs/msg/RocketState | Count: '):
        assert line in info.output()

    node, executor = make_node()
    worlds: list[msg.World] = []
    states: list[msg.RocketState] = []
    node.create_subscription(msg.World, 'world', worlds.append, qos.WORLD)
    node.create_subscription(msg.RocketState, 'state', states.append, qos.EVENTS)
    expected = sum(1 for one in messages(path, topics=['/state']))
    # On a busy machine it is found later than the player waits for anybody.
    end = time.monotonic() + 120.0
    while len(states) != expected and time.monotonic() < end:
        states.clear()
        played = processes.start('ros2', 'bag', 'play', '-r', '10', str(path))
        while played.running:
            executor.spin_once(timeout_sec=0.1)
        assert played.wait(1.0) == 0
        for _ in range(expected):
            executor.spin_once(timeout_sec=0.1)
    assert len(states) == expected, played.output()
    assert worlds
    assert worlds[0].world == 'rocket'
    assert {int(step) for state in states for step in state.step} == set(range(FALL + 1))


def test_a_recorder_of_impossible_topics_leaves_nothing(
        processes: Processes, tmp_path: Path) -> None:
    recorder = processes.fork_node(
        'rocket_sim_node', 'bag_recorder', output=tmp_path / 'bag', topics='state 7up')
    assert recorder.wait(20.0) == 2
    assert "parameter topics: got '7up'" in recorder.output()
    assert not list(tmp_path.glob('bag*'))


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (('record', '--regex', 'x'), "'--regex' is not supported here"),
    (('info', '/nowhere/bag'), '/nowhere/bag'), (('convert',), "invalid choice: 'convert'")])
def test_bad_arguments_of_the_bag_command_are_refused_by_name(
    processes: Processes, arguments: tuple[str, ...], complaint: str,
) -> None:
    command = processes.start('ros2', 'bag', *arguments)
    assert command.wait(20.0) in (1, 2)
    assert complaint in command.output()
    assert 'Traceback' not in command.output()
