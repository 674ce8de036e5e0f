# SPDX-License-Identifier: Apache-2.0
"""Node `bag_recorder`: records topics to a bag of ROS 2 (MCAP).

No other node depends on it: it may start late, fall behind, die and be restarted.
"""
from __future__ import annotations

import importlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rclpy.validate_topic_name import validate_topic_name

from rocket_sim_node.bags import definitions
from rocket_sim_node.bags.bag_file import COMPRESSIONS
from rocket_sim_node.bags.bag_file import BagFile
from rocket_sim_node.bags.metadata import Quality
from rocket_sim_node.bags.metadata import Topic
from rocket_sim_node.bags.missed_messages import counter_of
from rocket_sim_node.bags.monotonic_clock import MonotonicClock
from rocket_sim_node.nodes.listeners import NICENESS
from rocket_sim_node.nodes.listeners import SPIN_PERIOD
from rocket_sim_node.nodes.listeners import drain
from rocket_sim_node.nodes.listeners import notes_of
from rocket_sim_node.printable import printable
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.messages.definitions import hashes
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import USAGE_ERROR
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.wire.node.steady_clock import STEADY
from rocket_sim_node.wire.node.steady_clock import create_timer

_LOOK = 0.25
"""Seconds between two looks for new topics."""
_DEPTH = 1000
"""Messages of a topic that wait while the recorder is busy."""
_STAR = 'any_characters_'
_UNKNOWN = -1
"""Number of publishers of a topic that the next look examines in any case."""


@dataclass(frozen=True)
class BagParameters:
    """Parameters of the node."""

    output: str = setting(
        'bag', '', 'folder of the bag; it appears under its name at the end. An existing one is '
        'never overwritten: the new one is numbered (-2, -3, ...)')
    topics: str = setting(
        '', '', 'names of the topics to record, separated by spaces or commas; * stands for any '
        'characters. Empty: all topics except hidden ones')
    compression: str = setting(
        'zstd', '', 'compression of the bag', choices=tuple(COMPRESSIONS))


class _Recorded:
    """A topic that is being recorded."""

    def __init__(self, topic: Topic) -> None:
        """Start before the first message."""
        self.topic = topic
        self.counter = counter_of(topic.type_name)
        self.lost = 0
        self.publishers = _UNKNOWN
        self.profile: QoSProfile | None = None
        self.subscription: Any = None

    def missing(self) -> str:
        """Return what is missing so far; '' if nothing is."""
        parts = []
        if self.counter and self.counter.missed:
            parts.append(f'{self.counter.missed} {self.counter.unit} were not received')
        if self.lost:
            parts.append(f'DDS lost {self.lost} messages')
        return ', '.join(parts)


class BagNode:
    """Subscribes to topics as they appear, and writes their serialized messages to a bag."""

    def __init__(self, node: Node, bag: BagFile, wanted: Sequence[str]) -> None:
        """Start without topics.

        :param wanted: absolute names of the wanted topics, with stars; empty: all.
        """
        self._node = node
        self._bag = bag
        self._wanted = wanted
        self._recorded: dict[str, _Recorded] = {}
        self._refused: dict[str, str] = {}
        self._clock = MonotonicClock()
        self.count = 0
        """Messages received so far."""

    def look(self) -> None:
        """Subscribe to the wanted topics that are new or have other publishers than before."""
        for name, types in self._node.get_topic_names_and_types():
            recorded = self._recorded.get(name)
            if not self._is_wanted(name) or (
                    recorded is not None and recorded.topic.offered
                    and recorded.publishers == self._node.count_publishers(name)):
                continue
            try:
                self._record(name, types, recorded)
            except (ValueError, InvalidTopicNameException) as error:
                reason = str(error).partition('\n')[0]
                if self._refused.get(name) != reason:
                    self._refused[name] = reason
                    self._node.get_logger().error(
                        f'{printable(name)} ignored: {printable(reason)}')
        self._bag.tick()

    def _is_wanted(self, name: str) -> bool:
        if self._wanted:
            return any(fnmatchcase(name, pattern) for pattern in self._wanted)
        return not any(part.startswith('_') for part in name.split('/'))

    def _record(self, name: str, types: list[str], recorded: _Recorded | None) -> None:
        """Record a topic, which may have no publisher yet: then its first messages come, too.

        :param recorded: the topic, if it is recorded already but had no publisher so far.
        :raises ValueError: when its messages cannot be recorded.
        """
        if recorded is not None and not self._node.count_publishers(name):
            recorded.publishers = 0
            return
        if recorded is not None and recorded.topic.type_name in types:
            types = [recorded.topic.type_name]  # no messages of another type arrive
        if len(types) != 1:
            raise ValueError(f'it has the types {", ".join(types)}, expected one')
        if recorded is not None and types[0] != recorded.topic.type_name:
            raise ValueError(
                f'its type is now {types[0]}, expected {recorded.topic.type_name} as before')
        kind = _class_of(types[0])
        try:
            offers = self._offers(name, types[0])
        except ValueError:
            if recorded is not None and recorded.subscription is not None:
                self._node.destroy_subscription(recorded.subscription)
                recorded.subscription = recorded.profile = None
                recorded.publishers = _UNKNOWN
            raise
        topic = Topic(
            name, types[0], definitions.type_hash(types[0]), tuple(map(_quality, offers)))
        self._bag.add_topic(topic)
        self._refused.pop(name, None)
        if recorded is None:
            recorded = self._recorded[name] = _Recorded(topic)
            self._node.get_logger().info(f'recording {printable(name)} ({types[0]})')
        unknown = not recorded.topic.offered or recorded.profile is None
        recorded.topic, recorded.publishers = topic, self._node.count_publishers(name)
        profile = _profile(offers)
        if recorded.profile != profile and (unknown or _asks_more(recorded.profile, profile)):
            self._subscribe(recorded, kind, profile)

    def _offers(self, name: str, type_name: str) -> list[QoSProfile]:
        """Return the profiles of a topic's publishers.

        :raises ValueError: when one of them was built from another definition.
        """
        ends = [end for end in self._node.get_publishers_info_by_topic(name)
                if end.topic_type == type_name]
        expected = definitions.type_hash(type_name)
        others = {hash_ for _, hash_ in hashes(ends)} - {expected}
        if others:
            raise ValueError(
                f'its type {type_name} has the hash {min(others)}, expected {expected}: its '
                'publisher was built from another definition')
        return [end.qos_profile for end in ends]

    def _subscribe(self, recorded: _Recorded, kind: Any, profile: QoSProfile) -> None:
        """Subscribe, in place of an earlier subscription with another profile."""
        def on_message(data: bytes) -> None:
            self._on_message(recorded, data)

        def on_lost(event: Any) -> None:
            recorded.lost += event.total_count_change
            self._tell_missing(recorded)

        earlier = recorded.subscription
        recorded.profile = profile
        recorded.subscription = self._node.create_subscription(
            kind, recorded.topic.name, on_message, profile, raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=on_lost))
        if earlier is not None:
            self._node.destroy_subscription(earlier)

    def _on_message(self, recorded: _Recorded, data: bytes) -> None:
        self.count += 1
        if not recorded.topic.offered and not self._tell_offers(recorded):
            return
        missing = recorded.counter.note(data) if recorded.counter else ''
        if missing:
            self._node.get_logger().warning(
                f'{recorded.topic.name}: {missing} were not received',
                throttle_duration_sec=1.0, throttle_time_source_type=STEADY)
            self._tell_missing(recorded)
        # Kilted's events executor fails on callbacks that ask for DDS's own times of a message.
        now = self._clock.now()
        self._bag.write(recorded.topic.name, data, now, now)

    def _tell_offers(self, recorded: _Recorded) -> bool:
        """Tell the bag what the publishers of a topic offer that the last look did not find.

        The next look replaces the subscription; inside its own callback it must remain.

        :return: whether all of them have the topic's definition.
        """
        topic = recorded.topic
        try:
            offers = self._offers(topic.name, topic.type_name)
        except ValueError:
            return False  # the next look reports it
        self._bag.add_topic(replace(topic, offered=tuple(map(_quality, offers))))
        return True

    def _tell_missing(self, recorded: _Recorded) -> None:
        """Tell the bag what is missing: it may be closed at any message, on a full disk."""
        if missing := recorded.missing():
            self._bag.tell(recorded.topic.name, missing)

    def close(self) -> None:
        """Finish the bag, and say what is missing."""
        for name, recorded in self._recorded.items():
            if missing := recorded.missing():
                self._node.get_logger().warning(f'{printable(name)}: {missing}')
        self._bag.close()


def _class_of(type_name: str) -> Any:
    """Return the class of a message.

    :raises ValueError: when it is not installed.
    """
    package, _, name = type_name.partition('/msg/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, ValueError):
        raise ValueError(f'its type {type_name} is not installed') from None


def _absolute(node: Node, name: str) -> str:
    """Return the absolute name of a topic, or of several, with a star.

    :raises ParameterError: when it cannot be the name of a topic.
    """
    try:
        # A star is no part of a name.
        spelled = name.replace('*', _STAR)
        validate_topic_name(spelled)
        return str(node.resolve_topic_name(spelled)).replace(_STAR, '*')
    except InvalidTopicNameException as error:
        reason = str(error).splitlines()[0]
        raise ParameterError(f'parameter topics: got {name!r}: {reason}') from error


def _quality(profile: QoSProfile) -> Quality:
    """Return the words of an offered profile; what DDS does not tell is the default."""
    history = profile.history.name.lower()
    offered = history in ('keep_last', 'keep_all') and profile.depth > 0
    return Quality(
        profile.reliability.name.lower(), profile.durability.name.lower(),
        history if offered else 'keep_last', profile.depth if offered else Quality.depth)


def _profile(offers: list[QoSProfile]) -> QoSProfile:
    """Return a profile that takes what all publishers offer; without any, a reliable one."""
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = bool(offers) and all(
        offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def _asks_more(profile: QoSProfile | None, offered: QoSProfile) -> bool:
    """Return whether a subscription with a profile would miss some of what is offered."""
    return profile is None or (
        profile.reliability == ReliabilityPolicy.RELIABLE != offered.reliability) or (
        profile.durability == DurabilityPolicy.TRANSIENT_LOCAL != offered.durability)


def record(node: Node, executor: Executor) -> int:
    """Record until asked to stop, or until the disk is nearly full; return the exit status."""
    os.nice(NICENESS)
    parameters = Parameters(node)
    options = parameters.declare(BagParameters)
    parameters.finish()
    if not options.output.strip('/. '):
        raise ParameterError(f'parameter output: got {options.output!r}, expected a folder')

    wanted = [
        _absolute(node, name) for name in re.split(r'[\s,]+', options.topics.strip()) if name]

    note = notes_of(node)

    bag = BagFile(
        Path(options.output).absolute(), note, options.compression,
        os.environ.get('ROS_DISTRO', ''))
    recorder = BagNode(node, bag, wanted)
    note('INFO', f'recording to {options.output}')
    try:
        create_timer(node, _LOOK, recorder.look)
        while not stopping.requested() and bag.open:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
        drain(executor, lambda: recorder.count)
    finally:
        recorder.close()
    return 0 if bag.complete else USAGE_ERROR


def main() -> None:
    """Run the node."""
    leave(run('bag_recorder', record, expected=(ParameterError, ValueError, OSError)))


if __name__ == '__main__':
    main()
