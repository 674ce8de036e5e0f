# SPDX-License-Identifier: Apache-2.0
"""The file metadata.yaml of a bag, which `ros2 bag` and others read first."""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rocket_sim_node import input_file
from rocket_sim_node import plain_yaml

VERSION = 9
"""Version of the file's format, that of Jazzy and later."""
FILE = 'metadata.yaml'
MOST = 16 * 2**20
"""Maximum bytes of the file."""
_LAST = 2**62
"""Maximum nanoseconds; twice as many still are a date."""


@dataclass(frozen=True)
class Quality:
    """Quality of service that a publisher offers: words as in `ros2 topic info -v`, lower case."""

    reliability: str = 'reliable'
    durability: str = 'volatile'
    history: str = 'keep_last'
    depth: int = 10


@dataclass(frozen=True)
class Topic:
    """A recorded topic: its type, such as rocket_msgs/msg/World, and the type's hash."""

    name: str
    type_name: str
    type_hash: str
    offered: tuple[Quality, ...] = ()


def quality_values(quality: Quality) -> dict[str, Any]:
    """Return a quality of service in the form of the file."""
    unlimited = {'sec': 9223372036, 'nsec': 854775807}
    return {
        'history': quality.history, 'depth': quality.depth, 'reliability': quality.reliability,
        'durability': quality.durability, 'deadline': unlimited, 'lifespan': unlimited,
        'liveliness': 'automatic', 'liveliness_lease_duration': unlimited,
        'avoid_ros_namespace_conventions': False}


class _Dumper(yaml.SafeDumper):
    """Writes equal parts in full: not every reader knows anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return true."""
        return True


def metadata_text(
    topics: Sequence[tuple[Topic, int]], file: str, start: int, end: int, distribution: str,
    custom: Mapping[str, str],
) -> str:
    """Return the text of metadata.yaml.

    :param topics: with the number of messages of each.
    :param file: name of the MCAP file beside it.
    :param start: time of the first message, ns since the epoch; `end` of the last.
    :param distribution: of ROS 2, such as kilted.
    :param custom: anything else, by name.
    """
    count = sum(number for _, number in topics)
    span = {
        'starting_time': {'nanoseconds_since_epoch': start},
        'duration': {'nanoseconds': max(end - start, 0)}, 'message_count': count}
    return yaml.dump({'rosbag2_bagfile_information': {
        'version': VERSION, 'storage_identifier': 'mcap', **span,
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name, 'type': topic.type_name, 'serialization_format': 'cdr',
                'offered_qos_profiles': [quality_values(one) for one in topic.offered],
                'type_description_hash': topic.type_hash},
            'message_count': number} for topic, number in topics],
        'compression_format': '', 'compression_mode': '', 'relative_file_paths': [file],
        'files': [{'path': file, **span}],
        'custom_data': dict(custom) or None, 'ros_distro': distribution,
    }}, Dumper=_Dumper, sort_keys=False)


def read_metadata(bag: Path) -> dict[str, Any]:
    """Return what metadata.yaml says about a bag, which others may have written.

    :param bag: its folder.
    :raises ValueError: naming the file, when a part that readers use is not there or of another
        kind, and when the bag is not stored as MCAP.
    :raises OSError: when it cannot be read.
    """
    path = bag / FILE
    text = input_file.read_text(path, MOST)
    try:
        found = plain_yaml.load(text)['rosbag2_bagfile_information']
        topics = found['topics_with_message_count']
        parts: list[tuple[Any, type]] = [
            (found['storage_identifier'], str), (found['relative_file_paths'], list),
            *((name, str) for name in found['relative_file_paths']),
            (found['message_count'], int), (topics, list),
            *((topic['message_count'], int) for topic in topics),
            *((topic['topic_metadata'][name], str) for topic in topics
              for name in ('name', 'type', 'serialization_format')),
            (found.get('custom_data') or {}, dict)]
        for value, kind in parts:
            if not isinstance(value, kind):
                raise TypeError(f'got {value!r:.40}, expected a {kind.__name__}')
        for name, unit in (('starting_time', 'nanoseconds_since_epoch'),
                           ('duration', 'nanoseconds')):
            if not 0 <= found[name][unit] <= _LAST:
                raise ValueError(f'{name}: got {found[name][unit]}, expected 0 to {_LAST}')
    except (*plain_yaml.ERRORS, LookupError, TypeError, AttributeError) as error:
        raise ValueError(
            f'{path}: not the metadata of a bag ({" ".join(repr(error).split()):.200})') from error
    if found['storage_identifier'] != 'mcap':
        raise ValueError(
            f"{path}: stored as {found['storage_identifier']!r:.40}, expected 'mcap'")
    return dict(found)
