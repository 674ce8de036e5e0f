# SPDX-License-Identifier: Apache-2.0
"""Messages of a simulator for tests of bags, serialized as DDS sends them."""
from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Footer
from mcap.records import Header
from mcap.records import McapRecord
from rclpy.serialization import serialize_message
from rocket_msgs import msg

from rocket_sim_node.bags.bag_file import BagFile
from rocket_sim_node.bags.decoder import Decoder
from rocket_sim_node.bags.decoder import _Reading
from rocket_sim_node.bags.definitions import definition
from rocket_sim_node.bags.definitions import type_hash
from rocket_sim_node.bags.metadata import Quality
from rocket_sim_node.bags.metadata import Topic
from rocket_sim_node.telemetry.stamps import SimulatedTime
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.server.state_stream import StateStream
from rocket_sim_node.worlds import make

_MAGIC = b'\x89MCAP0\r\n'


def write_records(path: Path, records: Sequence[McapRecord]) -> Path:
    """Write records as an MCAP file without a summary, and return its path."""
    builder = RecordBuilder()
    for record in (Header('ros2', 'test'), *records, Footer(0, 0, 0)):
        record.write(builder)
    path.write_bytes(_MAGIC + builder.end() + _MAGIC)
    return path


def flight_messages(
    world: str, rockets: int, steps: int, session: int = 1, batch: int = 25,
) -> list[Any]:
    """Return the description of a world, followed by states of falling rockets.

    :param batch: number of states in a message.
    """
    simulated = make(world, rockets)
    spec = simulated.spec
    idle = (np.tile(np.float32(spec.action_idle), (rockets, 1)) if spec.continuous
            else np.full(rockets, spec.action_idle[0], np.int32))
    said: list[Any] = [conversion.world_to_message(spec, session, 0, msg.World.LOCKSTEP)]
    publisher = SimpleNamespace(publish=said.append, get_subscription_count=lambda: 1)
    node: Any = SimpleNamespace(create_publisher=lambda *_: publisher)
    states = StateStream(node, simulated, rockets, batch)
    time = SimulatedTime(spec.dt)
    time.begin_session(0)
    states.add(session, 0, time.at(0))
    for step in range(1, steps + 1):
        simulated.step(idle)
        states.add(session, step, time.at(step))
    states.flush()
    return said


@cache
def _decoder(type_name: str) -> Decoder:
    return Decoder(type_name, definition(type_name))


def serialized(message: Any) -> bytes:
    """Return a message as sent; `serialize_message` returns additional bytes after its end."""
    data = bytes(serialize_message(message))
    decoder = _decoder(f'rocket_msgs/msg/{type(message).__name__}')
    reading = _Reading(decoder._fields, data, '<')
    reading.message(decoder._first)
    return data[:reading._place]


def topic_of(message: Any, space: str = '') -> Topic:
    """Return the topic on which a simulator publishes a message."""
    name = {msg.World: 'world', msg.RocketState: 'state', msg.TrainingStatus: 'training'}[
        type(message)]
    type_name = f'rocket_msgs/msg/{type(message).__name__}'
    quality = Quality(durability='transient_local', depth=1) if name == 'world' else Quality()
    return Topic(f'{space}/{name}', type_name, type_hash(type_name), (quality,))


def write(bag: BagFile, messages: list[Any], space: str = '', at: int = 1_000_000_000) -> None:
    """Write messages at intervals of 20 ms."""
    for number, message in enumerate(messages):
        topic = topic_of(message, space)
        bag.add_topic(topic)
        now = at + number * 20_000_000
        bag.write(topic.name, serialized(message), now, now - 1000)
