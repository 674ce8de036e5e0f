# SPDX-License-Identifier: Apache-2.0
"""The recorder and the displays of a training ignore invalid messages."""
from __future__ import annotations

import array
import copy
import io
import os
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rocket_msgs import msg
from support.invalid_data.fuzzing import ANY_F32
from support.invalid_data.fuzzing import ANY_FLOAT
from support.invalid_data.fuzzing import ANY_U64
from support.invalid_data.fuzzing import WIRE_TEXT
from support.recording.bags import flight_messages

from ppo_agent_node.nodes.agent.status_message import status_from_message
from ppo_agent_node.terminal import Terminal
from rocket_sim_node.nodes.rerun_recorder import RecorderNode
from rocket_sim_node.nodes.ros_bridge import BridgeNode
from rocket_sim_node.nodes.ros_bridge import BridgeParameters
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks.base import Look
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.wire.messages import conversion

ROCKETS = 2
WORLDS = ('rocket', 'rocket_planar', 'lunar_lander')
ANY = {
    'uint8': ANY_U64.map(lambda value: value % 2**8),
    'uint32': ANY_U64.map(lambda value: value % 2**32), 'uint64': ANY_U64,
    'int32': st.one_of(st.sampled_from([-2**31, -1, 2**31 - 1]), st.integers(-2**31, 2**31 - 1)),
    'float': ANY_F32, 'double': ANY_FLOAT, 'string': WIRE_TEXT}


class Paper:
    """A sink that draws all it is given, and keeps nothing."""

    def __init__(self, live: bool) -> None:
        self.live = live
        self._stream = rr.RecordingStream('test')
        rr.memory_recording(self._stream)

    def begin(self, head: Put, look: Look) -> None:
        head(self._stream)

    def write(self, put: Put) -> None:
        put(self._stream)

    def write_trajectory(self, put: Put) -> bool:
        put(self._stream)
        return True

    def under_way(self, put: Put, until: int) -> None:
        put(self._stream)

    def close(self) -> None:
        pass


class Desk:
    """A recorder's node without DDS; its clock goes on by a minute at each look."""

    def __init__(self, live: bool) -> None:
        self.now, self.said, self.noted = 0.0, list[str](), list[str]()
        node: Any = SimpleNamespace(
            create_subscription=lambda *_: None, count_publishers=lambda _: 0,
            resolve_topic_name=lambda name: name,
            get_logger=lambda: SimpleNamespace(warning=lambda text, **_: self.said.append(text)))
        self.recorder = Recorder(
            RecordingFilter(rows=(0, 1), every_nth_episode=1), [Paper(live)],
            lambda _, text: self.noted.append(text),
            clock=lambda: self.now, settle=touchdown.follow)
        self.node = RecorderNode(node, self.recorder)

    def hear(self, message: Any) -> None:
        """Take a message as from its topic."""
        {msg.World: self.node._on_world, msg.RocketState: self.node._on_state,
         msg.TrainingStatus: self.node._on_training}[type(message)](message)

    def look(self) -> None:
        self.now += 60.0
        self.node.look_after_agents()
        self.node.tick()


@cache
def good(world: str, session: int) -> list[Any]:
    """Return the messages of a session in which each rocket falls down."""
    said = flight_messages(world, ROCKETS, 500, session, batch=125)
    said.append(msg.TrainingStatus(run='run', stage='finetune', iteration=3, level=2))
    return said


@st.composite
def harmed(draw: Any, message: Any) -> Any:
    """A good message with some fields made anything that their types hold."""
    message = copy.deepcopy(message)
    kinds = message.get_fields_and_field_types()
    for name in draw(st.lists(st.sampled_from(sorted(kinds)), min_size=1, max_size=4)):
        inner = kinds[name].removeprefix('sequence<').removesuffix('>')
        if inner.startswith('rocket_msgs'):
            setting = draw(st.sampled_from(message.settings))
            setting.value = draw(ANY_FLOAT)
            continue
        if inner == 'std_msgs/Header':
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = draw(ANY['int32']), draw(ANY['uint32'])
            message.header.frame_id = draw(WIRE_TEXT)
            continue
        kind, value = ANY[inner], getattr(message, name)
        if inner == kinds[name]:
            setattr(message, name, draw(kind))
        elif draw(st.booleans()) and len(value):  # one element
            value[draw(st.integers(0, len(value) - 1))] = draw(kind)
        else:  # another length
            some = draw(st.lists(kind, max_size=5))
            whole = list(value)[:draw(st.integers(0, len(value)))] + some
            setattr(message, name, array.array(value.typecode, whole)
                    if isinstance(value, array.array) else whole)
    return message


@pytest.mark.parametrize('live', [False, True])
@pytest.mark.parametrize('world', WORLDS)
@settings(max_examples=max(30, settings.default.max_examples // 10))
@given(data=st.data())
def test_a_recorder_keeps_recording_after_invalid_messages(
        world: str, live: bool, data: Any) -> None:
    desk = Desk(live)
    for message in good(world, 1):
        for _ in range(data.draw(st.integers(0, 2))):
            desk.hear(data.draw(harmed(message)))
        if data.draw(st.booleans()):
            desk.hear(message)
        desk.look()
    before = desk.recorder.flights
    for message in good(world, 2)[:-1]:
        desk.hear(message)
    desk.look()
    assert desk.recorder.flights >= before + ROCKETS
    desk.node.close()


def test_a_lander_of_three_legs_is_refused() -> None:
    desk = Desk(False)
    world, state, *_ = good('lunar_lander', 1)
    legs = conversion.to_sequence(np.zeros(3 * len(state.step)), 'f8')
    state = copy.deepcopy(state)
    state.leg_angle, state.contact = legs, array.array('B', map(int, legs))
    desk.hear(world)
    desk.hear(state)
    assert desk.said == [
        "state ignored: contact: for 3 legs, expected 2, as world 'lunar_lander' has"]


def landed(states: list[Any]) -> list[Any]:
    """Return states as if each flight that ends had landed."""
    states = copy.deepcopy(states)
    for state in states:
        state.outcome = array.array('B', (0 if code != state.NONE else code
                                          for code in state.outcome))
    return states


@pytest.mark.parametrize('harm', ['settings', 'mass', 'fuel', 'linear_velocity', 'orientation'])
def test_landings_that_the_contact_model_cannot_follow_are_recorded(harm: str) -> None:
    """The contact model simulates what follows a landing; for some states it has no result."""
    desk = Desk(False)
    world, *states, _ = copy.deepcopy(good('rocket', 1))
    states = landed(states)
    if harm == 'settings':
        for item in world.settings:
            item.value = -1.0
    else:
        for state in states:
            values = getattr(state, harm)
            values[:] = array.array('d', (
                -22_000.0 if harm in ('mass', 'fuel') else 1e29 for _ in values))
    for message in (world, *states):
        desk.hear(message)
    desk.look()
    assert desk.recorder.flights == ROCKETS
    assert desk.said == []
    assert len(desk.noted) == (harm == 'settings')


def test_flights_with_different_leg_counts_are_both_recorded() -> None:
    desk = Desk(False)
    world, *states, _ = copy.deepcopy(good('rocket', 1))
    states = landed(states)
    for row in range(2):  # the second one as by a vehicle with two legs
        for state in states:
            part = copy.deepcopy(state)
            if row:
                part.contact = array.array('B', bytes(2 * len(part.step)))
                part.leg_angle = array.array('d', [0.0] * (2 * len(part.step)))
            part.row = array.array('I', [row if own == row else 99 for own in part.row])
            desk.hear(world)
            desk.hear(part)
    desk.look()
    assert desk.recorder.flights == ROCKETS
    assert desk.said == []


@given(data=st.data())
def test_a_training_log_survives_invalid_status_messages(data: Any) -> None:
    message = msg.TrainingStatus(
        run='run', folder='run', stages=['clone', 'finetune'], stage='finetune', iteration=3,
        iterations=9, unit='iterations')
    screen = io.StringIO()
    with Terminal(screen) as terminal:
        for _ in range(3):
            terminal.show(status_from_message(data.draw(harmed(message))))
            terminal.tick()
        terminal.show(status_from_message(message))
    assert '3' in screen.getvalue()
    assert not set(screen.getvalue()) & {'\x1b', '\x07', '\x00'}


class Screen(io.StringIO):
    """A terminal that shows a display in place."""

    def isatty(self) -> bool:
        return True


@given(data=st.data())
def test_a_live_display_survives_invalid_status_messages(data: Any) -> None:
    message = msg.TrainingStatus(
        run='run', folder='run', stages=['clone', 'finetune'], stage='finetune', iteration=3,
        iterations=9, unit='iterations', mean_return=1.0)
    screen = Screen()
    with patch.dict(os.environ, {'TERM': 'xterm'}), Terminal(screen) as terminal:
        assert terminal.live
        for _ in range(3):
            terminal.show(status_from_message(data.draw(harmed(message))))
        terminal.show(status_from_message(message))
    assert not set(screen.getvalue()) & {'\x07', '\x00'}


class Bridge:
    """A bridge's node without DDS, which keeps the last message of each topic."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.count = 0
        self.last: dict[str, Any] = {}
        logger = SimpleNamespace(warning=lambda text, **_: self.said.append(text))
        node: Any = SimpleNamespace(
            create_publisher=self._publisher, create_subscription=lambda *_: None,
            get_logger=lambda: logger)
        self.node = BridgeNode(node, BridgeParameters(rows=(0, 1), max_rate=0.0, clock=True))

    def _publisher(self, kind: Any, topic: str, profile: Any) -> Any:
        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            serialize_message(message)
            self.count += 1
            self.last[topic] = message

        # With a subscriber, so that every message is built.
        return SimpleNamespace(publish=publish, get_subscription_count=lambda: 1)

    def hear(self, message: Any) -> None:
        """Take a message as from its topic."""
        if isinstance(message, msg.World):
            self.node._on_world(message)
        elif isinstance(message, msg.RocketState):
            self.node._on_state(message)


@pytest.mark.parametrize(('sec', 'nanosec', 'warning'), [
    (-1, 0, 'header.stamp.sec: got -1, expected 0 to 1073741824'),
    (-2**31, 2**32 - 1, 'header.stamp.sec: got -2147483648, expected 0 to 1073741824'),
    (2**31 - 1, 0, 'header.stamp.sec: got 2147483647, expected 0 to 1073741824'),
    (5, 10**9, 'header.stamp.nanosec: got 1000000000, expected 0 to 999999999'),
    (0, 2**32 - 1, 'header.stamp.nanosec: got 4294967295, expected 0 to 999999999'),
    (2**30, 0, '')])
def test_an_invalid_stamp_is_ignored_and_reported(
        sec: int, nanosec: int, warning: str) -> None:
    """The next session is shown, also after the latest valid stamp."""
    bridge = Bridge()
    world, state, *_ = copy.deepcopy(good('rocket', 1))
    bridge.hear(world)
    before = bridge.count
    state.header.stamp.sec, state.header.stamp.nanosec = sec, nanosec
    bridge.hear(state)
    assert bridge.said == ([f'state ignored: {warning}'] if warning else [])
    assert (bridge.count == before) == bool(warning)
    bridge.said.clear()
    world, *states, _ = good('rocket', 2)
    for message in (world, *states):
        bridge.hear(message)
    assert bridge.said == []
    end = conversion.stamp_of(states[-1].header)
    begin = 0 if warning else 2**30 * 10**9 + round(world.dt * 1e9)
    clock = bridge.last['/clock'].clock
    assert clock.sec * 10**9 + clock.nanosec == begin + end


@pytest.mark.parametrize('world', WORLDS)
@settings(max_examples=max(5, settings.default.max_examples // 10))
@given(data=st.data())
def test_a_bridge_keeps_publishing_after_invalid_messages(world: str, data: Any) -> None:
    bridge = Bridge()
    for message in good(world, 1)[:3]:
        for _ in range(data.draw(st.integers(0, 2))):
            bridge.hear(data.draw(harmed(message)))
        if data.draw(st.booleans()):
            bridge.hear(message)
    before = bridge.count
    bridge.said.clear()
    for message in good(world, 2)[:-1]:
        bridge.hear(message)
    assert bridge.said == []
    assert bridge.count > before
    state = good(world, 2)[-2]
    pose = bridge.last['rocket_1/pose'].pose.position
    assert [pose.x, pose.y, pose.z] == list(state.position[-3:])
