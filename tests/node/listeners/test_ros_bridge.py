# SPDX-License-Identifier: Apache-2.0
"""The bridge as a process: its standard messages agree with topic `state`."""
from __future__ import annotations

import json
import re
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from rocket_msgs import msg
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from support.nodes.falling_rockets import FALL
from support.nodes.falling_rockets import Simulator
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.users.foxglove_viewer import Viewer
from support.users.views_subscriber import STREAMS
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker
from visualization_msgs.msg import MarkerArray

from rocket_sim_node.bags.definitions import definition
from rocket_sim_node.nodes.ros_bridge import BridgeParameters
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.rocket import conditions

PATIENT = QoSProfile(depth=2000)
TF_HASH = 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087'
"""of tf2_msgs/msg/TFMessage, as `ros2 topic info -v` of ROS 2's own packages prints it"""


class Listener:
    """Keeps received messages, by topic."""

    def __init__(self, make_node: Callable[..., Any]) -> None:
        self.node, self._executor = make_node()
        self.heard: dict[str, list[Any]] = {}

    def listen(self, topic: str, kind: Any, profile: Any = PATIENT) -> list[Any]:
        """Subscribe; return the list of messages, which grows."""
        kept = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, kept.append, profile)
        return kept

    def wait_until(self, done: Callable[[], bool], seconds: float = 20.0) -> None:
        """Receive until it is done."""
        def look() -> bool:
            for _ in range(200):
                self._executor.spin_once(timeout_sec=0.001)
            return done()

        wait_until(look, seconds, lambda: str({
            topic: len(kept) for topic, kept in self.heard.items()}))


@pytest.fixture
def listener(processes: Processes, make_node: Callable[..., Any]) -> Listener:
    """Return a listener in the domain of the test."""
    return Listener(make_node)


def start(processes: Processes, **parameters: object) -> Process:
    bridge = processes.fork_node('rocket_sim_node', 'ros_bridge', **parameters)
    bridge.wait_for('standard views of rockets', 20.0)
    return bridge


def stamp_of(message: Any) -> int:
    return int(Time.from_msg(message.header.stamp).nanoseconds)


def numbers(message: Any, names: str = 'xyz') -> list[float]:
    return [getattr(message, name) for name in names]


def turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return q v q*, a vector of the body in the world, by Hamilton's product of quaternions."""
    def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array((*(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])),
                         a[3] * b[3] - a[:3] @ b[:3]))

    conjugate = quaternion * (-1.0, -1.0, -1.0, 1.0)
    return product(product(quaternion, np.array((*vector, 0.0))), conjugate)[:3]


def test_messages_agree_with_the_state(
    processes: Processes, simulator: Simulator, listener: Listener,
) -> None:
    bridge = start(processes, rows='[0, 1]', max_rate=0.0, clock=True)
    states = listener.listen('state', msg.RocketState, qos.EVENTS)
    clocks = listener.listen('/clock', Clock)
    transforms = listener.listen('/tf', TFMessage)
    streams = {name: listener.listen(f'rocket_1/{name}', kind) for name, kind in STREAMS.items()}
    # Publishers of a rocket come with the description of its world.
    simulator.describe()
    listener.wait_until(lambda: all(
        listener.node.count_publishers(topic) for topic in listener.heard))
    wait_until(lambda: simulator.state.get_subscription_count() == 2, 20.0)
    sent = 0

    def fall(steps: int) -> None:
        """Fly a little at a time: a publisher keeps only so much for a listener that is slow."""
        nonlocal sent
        simulator.begin(training=False)
        for done in range(0, steps, 50):
            count = min(50, steps - done)
            simulator.fall(count)
            sent += count
            listener.wait_until(lambda least=sent: all(
                len(kept) >= least for kept in (transforms, *streams.values())))

    fall(FALL + 20)
    fall(20)

    def samples() -> list[Samples]:
        return [samples_of(state) for state in states]

    def mine() -> np.ndarray:
        found = [one.values[one.row == 1] for one in samples()]
        return np.concatenate(found) if found else np.empty((0, 1))

    expected = FALL + 20 + 1 + 1 + 21  # the step at which the episode ended is there twice
    listener.wait_until(lambda: len(mine()) == expected and all(
        len(kept) == expected for kept in streams.values()) and len(transforms) == expected)
    values = mine()

    stamps = [stamp_of(message) for message in streams['odom']]
    assert np.all(np.diff(stamps) > 0)
    assert stamps[1] - stamps[0] == 20_000_000
    # Only the newest time counts: when many steps arrive at once, the queue of one may lose some.
    times = [Time.from_msg(clock.clock).nanoseconds for clock in clocks]
    assert np.all(np.diff(times) > 0)
    assert set(times) <= set(stamps)
    assert len(times) > expected // 2
    listener.wait_until(lambda: Time.from_msg(clocks[-1].clock).nanoseconds == stamps[-1])
    for kept in streams.values():
        assert [stamp_of(message) for message in kept] == stamps

    moved = [one for message in transforms for one in message.transforms
             if one.child_frame_id == 'rocket_1/base_link']
    assert [stamp_of(one) for one in moved] == stamps
    for k, given in enumerate(values):
        position = given[FIELDS['position']].tolist()
        orientation = given[FIELDS['orientation']].tolist()
        odom, pose, transform = streams['odom'][k], streams['pose'][k], moved[k]
        assert odom.header.frame_id == pose.header.frame_id == transform.header.frame_id == 'world'
        assert odom.child_frame_id == 'rocket_1/base_link'
        for found, turn in (
                (odom.pose.pose.position, odom.pose.pose.orientation),
                (pose.pose.position, pose.pose.orientation),
                (transform.transform.translation, transform.transform.rotation)):
            assert numbers(found) == position
            assert numbers(turn, 'xyzw') == orientation
        for twist, name in ((odom.twist.twist.linear, 'linear_velocity'),
                            (odom.twist.twist.angular, 'angular_velocity')):
            np.testing.assert_allclose(
                turned(np.array(orientation), np.array(numbers(twist))), given[FIELDS[name]],
                atol=1e-9)
        assert streams['imu'][k].header.frame_id == 'rocket_1/base_link'
        assert numbers(streams['imu'][k].angular_velocity) == numbers(odom.twist.twist.angular)
        joints = streams['joint_states'][k]
        assert dict(zip(joints.name, joints.position, strict=True)) == {
            'throttle': given[FIELDS['throttle']][0]}
    unknown = [message.linear_acceleration_covariance[0] == -1.0 for message in streams['imu']]
    assert unknown.count(True) == 3  # the first states of three episodes
    falling = np.array([numbers(message.linear_acceleration) for message in streams['imu'][1:50]])
    assert np.linalg.norm(falling, axis=1).max() < 2.0  # drag only: it does not feel gravity

    info = listener.node.get_publishers_info_by_topic('/tf')
    assert str(info[0].topic_type_hash) == TF_HASH
    bridge.signal(signal.SIGTERM)
    assert bridge.wait(10.0) == 0
    assert f'{expected} states shown' in bridge.output()
    assert 'Traceback' not in bridge.output()


@pytest.mark.parametrize(('world', 'drawn', 'legs', 'actions'), [
    ('rocket', conditions.settings('mix'), 0, ([0.6, 0.5, -0.3], [-0.2, -0.4, 0.6])),
    ('rocket_planar', conditions.settings('mix'), 0, ([0.6, 0.0, 0.5], [-0.2, 0.0, -0.4])),
    ('lunar_lander', {}, 2, (2, 1, 3))])
def test_engines_wind_joints_and_conditions_agree_with_the_state(
    processes: Processes, simulator: Simulator, listener: Listener, world: str,
    drawn: dict[str, Any], legs: int, actions: tuple[Any, ...],
) -> None:
    """A burning, turning flight."""
    start(processes, rows='[0, 1]', max_rate=0.0)
    states = listener.listen('state', msg.RocketState, qos.EVENTS)
    streams = {name: listener.listen(f'rocket_1/{name}', kind) for name, kind in STREAMS.items()}
    statuses = listener.listen('rocket_1/conditions', DiagnosticStatus, qos.LATCHED)
    simulator.take(world, **drawn)
    simulator.describe()
    listener.wait_until(lambda: all(
        listener.node.count_publishers(topic) for topic in listener.heard))
    wait_until(lambda: simulator.state.get_subscription_count() == 2, 20.0)
    simulator.begin(training=False)
    for action in actions:
        simulator.fall(20, action)
    expected = 20 * len(actions) + 1
    listener.wait_until(lambda: all(len(kept) == expected for kept in streams.values()) and sum(
        np.count_nonzero(np.equal(state.row, 1)) for state in states) == expected)

    def given(name: str, width: int) -> np.ndarray:
        """Return a quantity of the second rocket, a row for each step."""
        return np.concatenate([
            np.reshape(getattr(state, name), (len(state.row), -1))[np.equal(state.row, 1)]
            for state in states]).reshape(expected, width)

    orientation, torque = given('orientation', 4), given('torque', 3)
    thrust, lateral = given('thrust', 1)[:, 0], given('lateral_thrust', 1)[:, 0]
    assert thrust.any()
    assert lateral.any() or torque.any()
    assert np.ptp(orientation, axis=0).max() > 0.01  # it turns
    forces = np.array([numbers(one.wrench.force) for one in streams['wrench']])
    np.testing.assert_array_equal(
        forces, np.stack([lateral, np.zeros(expected), thrust], axis=1))
    for k, one in enumerate(streams['wrench']):
        assert one.header.frame_id == 'rocket_1/base_link'
        np.testing.assert_allclose(
            turned(orientation[k], np.array(numbers(one.wrench.torque))), torque[k],
            rtol=1e-9, atol=1e-6)
    wind = np.array([numbers(one.accel.linear) for one in streams['wind']])
    np.testing.assert_array_equal(wind, given('disturbance', 3))
    assert wind.any() == bool(drawn)
    joints = streams['joint_states']
    assert {tuple(one.name) for one in joints} == {
        ('throttle', *('left_leg', 'right_leg')[:legs])}
    positions = np.array([one.position for one in joints])
    np.testing.assert_array_equal(positions[:, 0], given('throttle', 1)[:, 0])
    if legs:
        np.testing.assert_array_equal(positions[:, 1:], given('leg_angle', legs))
    efforts = np.array([one.effort for one in joints])
    np.testing.assert_array_equal(efforts[:, 0], thrust)
    assert not efforts[:, 1:].any()
    if drawn:
        names = make(world, 1).spec.condition_names
        listener.wait_until(lambda: bool(statuses))
        kept = {item.key: float(item.value) for item in statuses[-1].values}
        assert list(kept) == list(names)
        assert list(kept.values()) == given('conditions', len(names))[-1].tolist()
        assert any(kept.values())


def test_a_late_viewer_sees_the_whole_path(
    processes: Processes, simulator: Simulator, listener: Listener,
) -> None:
    start(processes, rows='[0]', max_rate=0.0)
    poses = listener.listen('rocket_0/pose', PoseStamped)
    simulator.begin(training=False)
    listener.wait_until(lambda: listener.node.count_publishers('rocket_0/pose') > 0)
    simulator.fall(60)

    def falls_on_until(received: Callable[[], bool]) -> Callable[[], bool]:
        def look() -> bool:
            simulator.fall(1)
            return received()
        return look

    listener.wait_until(falls_on_until(
        lambda: bool(poses) and stamp_of(poses[-1]) >= 1_200_000_000))
    markers = listener.listen('rocket_0/markers', MarkerArray)
    listener.wait_until(falls_on_until(lambda: bool(markers)))
    paths = [marker for marker in markers[0].markers if marker.ns == 'path']
    assert len(paths[0].points) > 60


def test_late_joiners_receive_latched_messages(
    processes: Processes, simulator: Simulator, listener: Listener,
) -> None:
    start(processes, rows='[0]')
    markers = listener.listen('rocket_0/markers', MarkerArray)
    simulator.begin(training=False)
    listener.wait_until(lambda: listener.node.count_publishers('rocket_0/markers') > 0)
    simulator.fall(FALL + 20)

    def labels() -> list[str]:
        return [marker.text for message in markers for marker in message.markers
                if marker.ns == 'label']

    listener.wait_until(lambda: any('too fast' in label for label in labels()) and any(
        'episode 1' in label for label in labels()))
    description = listener.listen('robot_description', String, qos.LATCHED)
    scene = listener.listen('markers', MarkerArray, qos.LATCHED)
    drawn = listener.listen('rocket_0/conditions', DiagnosticStatus, qos.LATCHED)
    listener.wait_until(lambda: bool(description and scene and drawn))
    robot = ElementTree.fromstring(description[-1].data)
    assert [link.attrib['name'] for link in robot.iter('link')] == ['base_link', 'throttle_link']
    found = {marker.ns: marker for marker in scene[-1].markers}
    assert found['outcomes'].action == Marker.ADD
    assert len(found['outcomes'].points) == len(found['outcomes'].colors) == 1
    assert found['limit'].points[0].x == 15.0
    names = make('rocket', 1).spec.condition_names
    assert [value.key for value in drawn[-1].values] == list(names)
    assert drawn[-1].message == 'episode 1'
    on_body = [marker for message in markers for marker in message.markers
               if marker.ns == 'flame']
    assert {marker.header.frame_id for marker in on_body} == {'rocket_0/base_link'}


def test_invalid_descriptions_and_states_are_left_out_with_a_line(
    processes: Processes, simulator: Simulator,
) -> None:
    bridge = start(processes)
    wait_until(lambda: simulator.state.get_subscription_count() > 0, 20.0)
    state = conversion.state_to_message(np.zeros(2, np.uint64), simulator.telemetry(), 1)
    simulator.state.publish(state)
    bridge.wait_for('state ignored: arrived before the description of the world', 10.0)
    time.sleep(1.1)  # it says so once a second
    message = conversion.world_to_message(make('rocket', 2).spec, 1, 0, msg.World.LOCKSTEP)
    message.dt = 0.0
    simulator.description.publish(message)
    bridge.wait_for('world ignored: world: dt: got 0.0', 10.0)
    message.dt = 0.02
    simulator.description.publish(message)
    time.sleep(1.1)
    state.orientation[0] = 3.0
    simulator.state.publish(state)
    bridge.wait_for('state ignored: orientation: a quaternion of length', 10.0)
    bridge.signal(signal.SIGTERM)
    assert bridge.wait(10.0) == 0
    assert 'Traceback' not in bridge.output()


def test_views_for_rviz_and_foxglove_show_all_that_is_drawn_and_name_real_topics() -> None:
    share = Path(get_package_share_directory('rocket_sim_node')) / 'views'
    rviz = yaml.safe_load((share / 'hoverslam.rviz').read_text())
    foxglove = json.loads((share / 'foxglove.json').read_text())
    rockets = [f'rocket_{row}' for row in BridgeParameters().rows]
    drawn = {'/robot_description', '/markers', *(f'/{one}/markers' for one in rockets)}
    real = drawn | {f'/{one}/{name}' for one in rockets for name in STREAMS}
    displays = rviz['Visualization Manager']['Displays']
    asked = {display.get('Topic', display.get('Description Topic'))['Value']
             for display in displays if 'Topic' in display or 'Description Topic' in display}
    assert drawn <= asked <= real
    assert [display['TF Prefix'] for display in displays if 'TF Prefix' in display] == rockets
    assert rviz['Visualization Manager']['Global Options']['Fixed Frame'] == 'world'
    view = foxglove['configById']['3D!views']
    assert set(view['topics']) == drawn
    models = [layer for layer in view['layers'].values() if layer.get('topic')]
    assert {layer['topic'] for layer in models} == {'/robot_description'}
    assert [layer['framePrefix'] for layer in models] == [f'{one}/' for one in rockets]
    plots = [path['value'] for config in foxglove['configById'].values()
             for path in config.get('paths', ())]
    assert plots
    for path in plots:
        topic, *fields = re.split(r'\.|\[\d+\]', path)
        assert topic in real
        value = STREAMS[topic.rpartition('/')[2]]()
        for field in filter(None, fields):
            value = getattr(value, field)


def test_foxglove_gets_the_same_messages(
    processes: Processes, simulator: Simulator, listener: Listener,
) -> None:
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    serving = {'max_rate': 0.0, 'rows': '[1]', 'serve_foxglove': True, 'foxglove_port': port}
    bridge = start(processes, **serving)
    bridge.wait_for(f'Foxglove can connect to ws://127.0.0.1:{port}', 1.0)
    odom = listener.listen('rocket_1/odom', Odometry)
    described = listener.listen('robot_description', String, qos.LATCHED)
    simulator.begin(training=False)
    listener.wait_until(lambda: bool(described) and listener.node.count_publishers(
        'rocket_1/odom') > 0)
    # Viewers that come late: what is latched is there.
    with Viewer(f'ws://127.0.0.1:{port}') as viewer, Viewer(f'ws://127.0.0.1:{port}') as second:
        for one in (viewer, second):
            wait_until(lambda one=one: one.receive() or '/rocket_1/odom' in one.channels, 20.0)
            one.subscribe('/rocket_1/odom')  # in force when the answer to the next one is there
            urdf = one.subscribe('/robot_description')
            wait_until(lambda one=one, urdf=urdf: one.receive() or bool(urdf), 20.0)
            assert deserialize_message(urdf[0][1], String) == described[0]
        shown = viewer.received['/rocket_1/odom']
        wait_until(lambda: simulator.state.get_subscription_count() == 1, 20.0)
        simulator.fall(30)
        listener.wait_until(lambda: len(odom) == 31)  # the start as well
        wait_until(lambda: viewer.receive() or len(shown) >= 30, 20.0)
        last = odom[-len(shown):]
        assert [deserialize_message(data, Odometry) for _, data in shown] == last
        assert [stamp for stamp, _ in shown] == [stamp_of(message) for message in last]
        assert viewer.time == stamp_of(odom[-1])
        channel = viewer.channels['/rocket_1/odom']
        assert (channel['encoding'], channel['schemaName'], channel['schemaEncoding']) == (
            'cdr', 'nav_msgs/msg/Odometry', 'ros2msg')
        assert channel['schema'] == definition('nav_msgs/msg/Odometry')
        refused = processes.fork_node('rocket_sim_node', 'ros_bridge', **serving)
        assert refused.wait(20.0) == 2
        assert f'foxglove_port: {port} is taken by another program' in refused.output()
    bridge.signal(signal.SIGINT)
    assert bridge.wait(20.0) == 0


@pytest.mark.parametrize('mode', ['lockstep', 'realtime'])
def test_a_node_with_use_sim_time_follows_the_simulation(
        mode: str, processes: Processes, listener: Listener) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=2, mode=mode)
    processes.fork_node('ppo_agent_node', 'expert_pilot', episodes=0)
    start(processes, clock=True)
    listener.node.set_parameters([Parameter('use_sim_time', value=True)])
    clocks = listener.listen('/clock', Clock)
    ticks: list[int] = []
    listener.node.create_timer(
        0.25, lambda: ticks.append(listener.node.get_clock().now().nanoseconds))
    listener.wait_until(lambda: len(ticks) - ticks.count(0) > 6, 60.0)
    ticks = ticks[ticks.count(0):]  # 0: before the first message on /clock
    assert ticks == sorted(ticks)  # equal where two ticks fall between two messages
    times = [Time.from_msg(clock.clock).nanoseconds for clock in clocks]
    assert times == sorted(times)
    assert 0 < ticks[-1] <= times[-1] + 1e9
    if mode == 'realtime':  # in lock-step the simulation is faster than a timer can be
        assert np.median(np.diff(ticks)) == pytest.approx(0.25e9, abs=0.15e9)
