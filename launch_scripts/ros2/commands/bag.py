# SPDX-License-Identifier: Apache-2.0
"""Bags: recording them, what is in them, and publishing it again."""
from __future__ import annotations

import argparse
import json
import os
import time
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import QoSReliabilityPolicy

from ros2 import graph
from ros2 import packages
from ros2.errors import CommandError
from ros2.verb import Verb

_INDENT = 19
"""columns before what the real command says about a bag"""
_MATCH_SECONDS = 1.0
"""time for subscribers to find the publishers of a bag that is played"""
_NANOSECONDS = 1_000_000_000


def record(args: argparse.Namespace) -> None:
    """Become node bag_recorder, which says what it records.

    :raises CommandError: when no topic is chosen.
    """
    names = [*args.topics, *(args.topics_option or ())]
    if not names and not args.all:
        raise CommandError('Need to specify at least one topic or --all')
    output = args.output or datetime.now().strftime('rosbag2_%Y_%m_%d-%H_%M_%S')
    if Path(output).exists():
        raise CommandError(f"Output folder '{output}' already exists.")
    path = str(packages.executable('rocket_sim_node', 'bag_recorder'))
    parameters = {'output': output}
    if not args.all:
        parameters['topics'] = ' '.join(map(graph.absolute, names))
    # Quoted: rcl reads a bare 2024 or true as another type, and refuses an empty text.
    arguments = [word for name, value in parameters.items()
                 for word in ('-p', f'{name}:={json.dumps(value, ensure_ascii=False)}')]
    try:
        os.execv(path, [path, '--ros-args', *arguments])
    except OSError as error:
        raise CommandError(f'{path}: {error.strerror}') from error


def _metadata(bag: str) -> dict[str, Any]:
    """Return the content of a bag's metadata.yaml.

    :raises CommandError: when there is no such bag, or it is not stored as MCAP.
    """
    from rocket_sim_node.bags.metadata import read_metadata
    from rocket_sim_node.bags.reader import files_of
    path = Path(bag)
    if not path.exists():
        raise CommandError(f"bag {bag}: Bag path '{bag}' does not exist!")
    try:
        files_of(path)
        if not path.is_dir():
            raise ValueError(f'{path}: expected the folder of a bag')
        return read_metadata(path)
    except (ValueError, OSError) as error:
        raise CommandError(str(error)) from None


def _clock(nanoseconds: int) -> str:
    seconds, rest = divmod(nanoseconds, _NANOSECONDS)
    day = datetime.fromtimestamp(seconds).strftime('%b %e %Y %H:%M:%S')
    return f'{day}.{rest:09d} ({seconds}.{rest:09d})'


def _size(count: float) -> str:
    for unit in ('B', 'KiB', 'MiB', 'GiB'):
        if count < 1024.0 or unit == 'GiB':
            break
        count /= 1024.0
    return f'{count:.1f} {unit}'


def info(args: argparse.Namespace) -> None:
    """Print what a bag holds."""
    from rocket_sim_node.bags.reader import files_of
    from rocket_sim_node.printable import printable
    found = _metadata(args.bag_path)
    start = found['starting_time']['nanoseconds_since_epoch']
    duration = found['duration']['nanoseconds']
    files = found['relative_file_paths']
    size = sum(path.stat().st_size for path in files_of(args.bag_path))
    topics = [
        f"Topic: {one['topic_metadata']['name']} | Type: {one['topic_metadata']['type']} | "
        f"Count: {one['message_count']} | Serialization Format: "
        f"{one['topic_metadata']['serialization_format']}"
        for one in found['topics_with_message_count']]
    print()
    for title, lines in (
            ('Files:', files), ('Bag size:', [_size(size)]),
            ('Storage id:', [found['storage_identifier']]),
            ('ROS Distro:', [found.get('ros_distro', '')]),
            ('Duration:', [f'{duration // _NANOSECONDS}.{duration % _NANOSECONDS:09d}s']),
            ('Start:', [_clock(start)]), ('End:', [_clock(start + duration)]),
            ('Messages:', [found['message_count']]), ('Topic information:', topics)):
        print(f'{title:<{_INDENT}}' + f'\n{"":<{_INDENT}}'.join(
            printable(str(line)) for line in lines))
    for name, text in (found.get('custom_data') or {}).items():
        print(f'{"Note:":<{_INDENT}}' + printable(f'{name}: {text}'))


def play(args: argparse.Namespace) -> None:
    """Publish the messages of a bag with the times between them.

    :raises CommandError: when it cannot be played.
    """
    from rocket_sim_node.bags import mcap_file
    from rocket_sim_node.bags.read_errors import DAMAGED
    from rocket_sim_node.bags.reader import files_of
    if not args.rate > 0.0:
        raise CommandError(f'argument -r/--rate: {args.rate} is not a rate above 0')
    found = _metadata(args.bag_path)
    damaged: tuple[type[Exception], ...] = (*DAMAGED, OSError)
    with graph.direct_node() as node:
        try:
            publishers = {
                one['topic_metadata']['name']: _publisher(node, one['topic_metadata'])
                for one in found['topics_with_message_count']
                if not args.topics or one['topic_metadata']['name'] in args.topics}
        except (ValueError, TypeError, AttributeError) as error:  # a damaged metadata.yaml
            raise CommandError(f'{args.bag_path}: cannot be published: {error}') from None
        time.sleep(_MATCH_SECONDS)
        first: int | None = None
        began = time.monotonic()
        try:
            for file in files_of(args.bag_path):
                with file.open('rb') as stream:
                    for _, channel, message in mcap_file.messages(stream, publishers):
                        first = message.log_time if first is None else first
                        due = began + (message.log_time - first) / _NANOSECONDS / args.rate
                        time.sleep(max(0.0, due - time.monotonic()))
                        publishers[channel.topic].publish(message.data)
        except damaged as error:
            raise CommandError(f'{args.bag_path}: {error}') from None
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=_MATCH_SECONDS))


def _publisher(node: Node, topic: dict[str, Any]) -> Any:
    """Return a publisher that offers what the recorded one did, with a longer queue."""
    offers = topic['offered_qos_profiles'] or [{}]
    reliable = all(one.get('reliability') != 'best_effort' for one in offers)
    latched = any(one.get('durability') == 'transient_local' for one in offers)
    depth = max([int(one.get('depth', 0)) for one in offers])
    return node.create_publisher(graph.load_type(topic['type'], 'msg'), topic['name'], QoSProfile(
        depth=depth if latched else max(depth, 1000),
        reliability=(QoSReliabilityPolicy.RELIABLE if reliable
                     else QoSReliabilityPolicy.BEST_EFFORT),
        durability=(QoSDurabilityPolicy.TRANSIENT_LOCAL if latched
                    else QoSDurabilityPolicy.VOLATILE)))


_BAG = {'bag_path': {'help': 'Bag to open'}}
VERBS = {
    'record': Verb('Record ROS data to a bag', record, {
        'topics': {'nargs': '*', 'help': 'Topics to be recorded.'},
        '--topics': {
            'nargs': '+', 'dest': 'topics_option', 'metavar': 'TOPIC',
            'help': 'Topics to be recorded.'},
        '-a --all': {'action': 'store_true', 'help': 'Record all topics that are not hidden.'},
        '-o --output': {
            'help': 'Destination of the bagfile to create, defaults to a timestamped folder in '
                    'the current directory.'},
        '-s --storage': {
            'choices': ['mcap'], 'default': 'mcap', 'help': 'Storage identifier to be used.'}}),
    'info': Verb('Print information about a bag to the screen', info, _BAG),
    'play': Verb('Play back ROS data from a bag', play, {
        **_BAG,
        '--topics': {'nargs': '+', 'default': [], 'help': 'Topics to replay; default: all.'},
        '-r --rate': {'type': float, 'default': 1.0, 'help': 'Rate at which to play back.'}}),
}
