# SPDX-License-Identifier: Apache-2.0
"""Topics: their names, messages and rates."""
from __future__ import annotations

import argparse
import collections
import statistics
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import QoSReliabilityPolicy
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future

from ros2 import graph
from ros2 import messages
from ros2.errors import CommandError
from ros2.verb import Verb

_WINDOW = 10000
"""maximum number of messages from which a rate is calculated"""
_PERIOD = 1.0
"""seconds between two lines about a rate"""


def names(args: argparse.Namespace) -> None:
    """Print one topic a line."""
    with graph.direct_node() as node:
        graph.look_around(node)
        for name, _ in sorted(node.get_topic_names_and_types()):
            if not graph.is_hidden(name):
                print(name)


def _type_of(node: Node, topic: str) -> Any:
    """Return the class of the messages of a topic, or None if no node has it."""
    found: list[str] = []

    def look() -> bool:
        found[:] = dict(node.get_topic_names_and_types()).get(topic, [])
        return bool(found)

    if not graph.wait_for(node, look):
        return None
    if len(found) > 1:
        raise CommandError(
            f"Cannot echo topic '{topic}', as it contains more than one type: "
            f"[{', '.join(found)}]")
    return graph.load_type(found[0], 'msg')


def _quality(node: Node, topic: str) -> QoSProfile:
    """Return the quality of service that takes what all publishers of a topic offer."""
    sensor = qos_profile_sensor_data
    profile = QoSProfile(
        depth=sensor.depth, history=sensor.history, reliability=sensor.reliability,
        durability=sensor.durability)
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if not offers:
        return profile
    reliable = [offer.reliability == QoSReliabilityPolicy.RELIABLE for offer in offers]
    latched = [offer.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for offer in offers]
    profile.reliability = (
        QoSReliabilityPolicy.RELIABLE if all(reliable) else QoSReliabilityPolicy.BEST_EFFORT)
    profile.durability = (
        QoSDurabilityPolicy.TRANSIENT_LOCAL if all(latched) else QoSDurabilityPolicy.VOLATILE)
    for some, wanted, fallback in (
            (reliable, 'QoSReliabilityPolicy.RELIABLE', 'QoSReliabilityPolicy.BEST_EFFORT'),
            (latched, 'QoSDurabilityPolicy.TRANSIENT_LOCAL', 'QoSDurabilityPolicy.VOLATILE')):
        if any(some) and not all(some):
            print(f'Some, but not all, publishers are offering {wanted}. Falling back to '
                  f'{fallback} as it will connect to all publishers')
    return profile


def echo(args: argparse.Namespace) -> None:
    """Print messages until the end."""
    topic = graph.absolute(args.topic_name)
    with graph.direct_node() as node:
        if args.message_type is None:
            kind = _type_of(node, topic)
            if kind is None:
                print(f'WARNING: topic [{args.topic_name}] does not appear to be published yet')
                raise CommandError('Could not determine the type for the passed topic')
        else:
            kind = graph.load_type(args.message_type, 'msg')
        graph.wait_for(node, lambda: node.count_publishers(topic) > 0)
        done: Future = Future()

        def on_message(message: Any) -> None:
            if done.done():
                return
            try:
                print(messages.to_yaml(message) + '---', flush=True)
            except BrokenPipeError as error:
                done.set_exception(error)
                return
            if args.once:
                done.set_result(None)

        node.create_subscription(kind, topic, on_message, _quality(node, topic))
        rclpy.spin_until_future_complete(node, done)
        if done.done():
            done.result()


class Rate:
    """Times between the messages of one topic."""

    def __init__(self) -> None:
        """Keep the last of them, in seconds."""
        self._deltas: collections.deque[float] = collections.deque(maxlen=_WINDOW)
        self._last: float | None = None
        self._new = False

    def tick(self, now: float) -> None:
        """Note that a message came at `now` seconds."""
        if self._last is not None and now >= self._last:
            self._deltas.append(now - self._last)
            self._new = True
        elif self._last is not None:
            self._deltas.clear()
        self._last = now

    def text(self) -> str | None:
        """Return the two lines of the real command, or None when nothing is new."""
        if not self._new:
            return None
        self._new = False
        deltas = list(self._deltas)
        mean = statistics.fmean(deltas)
        rate = 1.0 / mean if mean > 0.0 else 0.0
        return (
            f'average rate: {rate:.3f}\n\tmin: {min(deltas):.3f}s max: {max(deltas):.3f}s '
            f'std dev: {statistics.pstdev(deltas):.5f}s window: {len(deltas)}')


def hz(args: argparse.Namespace) -> None:
    """Print rates until the end."""
    topic = graph.absolute(args.topic_name)
    with graph.direct_node() as node:
        kind = _type_of(node, topic)
        if kind is None:
            print(f'WARNING: topic [{args.topic_name}] does not appear to be published yet',
                  flush=True)
        while kind is None:
            kind = _type_of(node, topic)
        rate = Rate()
        node.create_subscription(
            kind, topic, lambda message: rate.tick(time.monotonic()), qos_profile_sensor_data,
            raw=True)
        due = time.monotonic() + _PERIOD
        while True:
            rclpy.spin_once(node, timeout_sec=max(0.0, due - time.monotonic()))
            if time.monotonic() < due:
                continue
            due = time.monotonic() + _PERIOD
            text = rate.text()
            if text is not None:
                print(text, flush=True)


_TOPIC = {'topic_name': {'help': "Name of the ROS topic to listen to (e.g. '/chatter')"}}
VERBS = {
    'list': Verb('Output a list of available topics', names),
    'echo': Verb('Output messages from a topic', echo, {
        **_TOPIC,
        'message_type': {
            'nargs': '?', 'help': "Type of the ROS message (e.g. 'std_msgs/msg/String')"},
        '--once': {
            'action': 'store_true', 'help': 'Print the first message received and then exit.'}}),
    'hz': Verb('Print the average publishing rate to screen', hz, _TOPIC),
}
