# SPDX-License-Identifier: Apache-2.0
"""A bag that is being written: a folder under a temporary name until it is complete."""
from __future__ import annotations

import errno
import fcntl
import os
import shutil
import time
from collections.abc import Iterator
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from typing import NamedTuple

import yaml
from mcap.records import Channel
from mcap.records import Message
from mcap.records import Schema
from mcap.writer import CompressionType
from mcap.writer import Writer

from rocket_sim_node.bags import mcap_file
from rocket_sim_node.bags.definitions import definition
from rocket_sim_node.bags.metadata import FILE
from rocket_sim_node.bags.metadata import Quality
from rocket_sim_node.bags.metadata import Topic
from rocket_sim_node.bags.metadata import metadata_text
from rocket_sim_node.bags.metadata import quality_values
from rocket_sim_node.bags.read_errors import DAMAGED
from rocket_sim_node.recording.sinks.destinations import RESERVE
from rocket_sim_node.recording.sinks.destinations import Note
from rocket_sim_node.recording.sinks.destinations import check_space
from rocket_sim_node.recording.sinks.destinations import is_at
from rocket_sim_node.recording.sinks.destinations import lock_error
from rocket_sim_node.recording.sinks.destinations import numbered

PARTIAL = '.partial'
"""End of the name of a folder that is not complete."""
FLUSH = 1.0
"""Seconds between two flushes: what a killed recorder can lose."""
_BROKEN = '.broken'
"""Suffix of the file of a killed recorder while it is being repaired."""
_CHECK = 4 * 2**20
"""Bytes between two checks of the free space."""
COMPRESSIONS = {'zstd': CompressionType.ZSTD, 'none': CompressionType.NONE}


@dataclass
class _Open:
    """A topic, its definition, and the number of its messages."""

    topic: Topic
    text: str
    channel: int | None = None
    """None until the first message: what is told of the topic may still change."""
    count: int = 0


class BagFile:
    """Writes messages to a bag.

    The folder gets its name when the bag is closed; until then it is `<name>.partial`, locked. A
    partial bag of a recorder that was killed is repaired and published first. An existing bag is
    never overwritten: the new one is numbered. A bag without messages is not kept.
    """

    def __init__(
        self, path: Path, note: Note, compression: str = 'zstd', distribution: str = '',
    ) -> None:
        """Open the partial bag.

        :param path: folder of the bag.
        :param compression: of :data:`COMPRESSIONS`.
        :param distribution: of ROS 2, for the metadata.
        :raises OSError: when the folder is not writable, has no space, or another recorder is
            writing there.
        """
        self._path, self._note = path, note
        self._compression, self._distribution = COMPRESSIONS[compression], distribution
        self._partial = path.with_name(path.name + PARTIAL)
        self._custom: dict[str, str] = {}
        self._topics: dict[str, _Open] = {}
        self._schemas: dict[str, int] = {}
        self.count = 0
        """Messages written so far."""
        self.complete = True
        """Whether nothing was left unfinished; known once the bag is closed."""
        path.parent.mkdir(parents=True, exist_ok=True)
        check_space(path.parent)
        self._lock = self._take()
        try:
            if any(self._partial.iterdir()):
                self._repair()
                if not is_at(self._lock, self._partial):  # what it held is published
                    repaired, self._lock = self._lock, self._take()
                    os.close(repaired)
            self._begin()
        except BaseException:
            with suppress(OSError):
                self._partial.rmdir()  # only if it is empty
            os.close(self._lock)
            raise

    @property
    def open(self) -> bool:
        """Whether more can be written."""
        return self._stream is not None

    def _take(self) -> int:
        """Return a lock on the partial folder, which is created if missing."""
        while True:
            self._partial.mkdir(exist_ok=True)
            lock = os.open(self._partial, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                os.close(lock)
                raise lock_error(
                    error, 'another recorder writes this bag', self._partial) from error
            if is_at(lock, self._partial):
                return lock
            os.close(lock)  # it was published at this moment

    def _begin(self) -> None:
        self._file = self._partial / f'{self._path.name}_0.mcap'
        self._stream: BinaryIO | None = self._file.open('xb')
        self._writer = Writer(self._stream, compression=self._compression)
        self._writer.start('ros2', 'hoverslam')
        self._start, self._end = 0, 0
        self._flushed, self._unchecked = time.monotonic(), 0

    def add_topic(self, topic: Topic) -> None:
        """Add a topic, or tell what its publishers offer; its definition is that installed.

        Once it has a message, what they offer is written and stays: package rosbags skips a topic
        of which the MCAP file and metadata.yaml tell different things.

        :raises ValueError: when the message is not installed.
        """
        one = self._topics.get(topic.name)
        if one is None:
            self._topics[topic.name] = _Open(topic, definition(topic.type_name))
        elif one.channel is None:
            one.topic = topic

    def _channel(self, one: _Open) -> int:
        """Return the channel of a topic, which is written if there is none yet."""
        if one.channel is None:
            topic, name = one.topic, one.topic.type_name
            if name not in self._schemas:
                self._schemas[name] = self._writer.register_schema(
                    name, 'ros2msg', one.text.encode('utf-8'))
            one.channel = self._writer.register_channel(topic.name, 'cdr', self._schemas[name], {
                'offered_qos_profiles': yaml.safe_dump(
                    [quality_values(offer) for offer in topic.offered], sort_keys=False),
                'topic_type_hash': topic.type_hash})
        return one.channel

    def write(self, topic: str, data: bytes, received: int, published: int) -> None:
        """Write a serialized message, or close the bag when the disk is nearly full.

        :param topic: name of one that was added.
        :param received: ns since the epoch; `published` likewise.
        """
        if self._stream is None:
            return
        try:
            self._unchecked += len(data)
            if self._unchecked >= _CHECK:
                self._unchecked = 0
                check_space(self._path.parent)
            self._put(topic, data, received, published)
        except OSError as error:
            self._end_here(error)
            return
        self.tick()

    def _named(self, error: OSError) -> OSError:
        """Return an error with the name of the file; `write` does not tell it."""
        if error.filename is not None:
            return error
        return OSError(error.errno, error.strerror or str(error), str(self._file))

    def _end_here(self, error: OSError) -> None:
        self._note('ERROR', f'the bag ends here: {self._named(error)}')
        self.close()

    def _put(self, topic: str, data: bytes, received: int, published: int) -> None:
        one = self._topics[topic]
        one.count += 1
        self._start = received if not self.count else min(self._start, received)
        self._end = max(self._end, received)
        self.count += 1
        self._writer.add_message(self._channel(one), received, data, published, one.count)

    def tick(self) -> None:
        """Write what has waited in memory for long enough; call it about once a second."""
        if self._stream is None or time.monotonic() - self._flushed < FLUSH:
            return
        self._flushed = time.monotonic()
        try:
            check_space(self._path.parent)
            self._writer.flush()
        except OSError as error:
            self._end_here(error)

    def tell(self, name: str, text: str) -> None:
        """Add a text to the metadata, in place of one with the same name."""
        self._custom[name] = text

    def close(self) -> None:
        """Finish the bag and give it its name."""
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        try:
            with stream:
                for one in self._topics.values():
                    self._channel(one)  # a topic without messages is in the bag, too
                self._writer.finish()
            if not self.count:
                shutil.rmtree(self._partial)
                self._note('WARN', f'nothing was recorded: {self._path} was not written')
                return
            self._describe()
            where = publish(self._partial, self._path)
            size = sum(file.stat().st_size for file in where.iterdir())
            self._note('INFO', f'bag saved: {where} ({self.count} messages, '
                               f'{size / 2**20:.1f} MiB)')
        except OSError as error:
            self.complete = False
            self._note('ERROR', f'the bag could not be finished and remains at {self._partial}; '
                                f'the next recorder with this output repairs it: '
                                f'{self._named(error)}')
        finally:
            os.close(self._lock)

    def _describe(self) -> None:
        """Write metadata.yaml, the last file."""
        text = metadata_text(
            [(one.topic, one.count) for one in self._topics.values()], self._file.name,
            self._start, self._end, self._distribution, self._custom)
        new = self._partial / f'{FILE}.new'
        new.write_text(text, 'utf-8')
        new.replace(self._partial / FILE)

    # Repair

    def _repair(self) -> None:
        """Publish the readable part of the partial bag."""
        broken = self._partial / f'{self._path.name}_0{_BROKEN}'
        if (self._partial / FILE).is_file():  # killed between the last file and the new name
            broken.unlink(missing_ok=True)
            where = publish(self._partial, self._path)
            self._note('WARN', f'a recorder was killed: its bag is complete, {where}')
            return
        left = broken.with_suffix('.mcap')
        (self._partial / f'{FILE}.new').unlink(missing_ok=True)
        if broken.is_file():  # killed while it repaired: what it was repairing is still whole
            left.unlink(missing_ok=True)
        elif left.is_file():
            left.replace(broken)
        else:
            return
        check_space(self._path.parent, broken.stat().st_size + RESERVE)
        try:
            damage = self._copy(broken)
        except (OSError, MemoryError) as error:
            number, reason = (
                (error.errno, error.strerror) if isinstance(error, OSError)
                else (errno.ENOMEM, 'out of memory'))
            raise OSError(
                number, f'left by a recorder that was killed, not repaired yet: {reason}',
                str(broken)) from error
        self._custom['repaired'] = 'its recorder was killed: the last second may be incomplete'
        if damage is not None:
            size = broken.stat().st_size
            # First, so that a kill of this recorder leaves all of it, too.
            kept = publish(
                broken, self._path.with_name(f'{self._path.name}.damaged.mcap'), '.mcap')
            place = f'damaged at byte {damage.place} of {size}'
            self._custom['repaired'] = f'its file was {place}'
            self._note('WARN', f'a recorder was killed and its bag is {place}; the whole file is '
                               f'kept as {kept}: {damage.error!r:.200}')
        if self.count:
            self._describe()
        broken.unlink(missing_ok=True)
        if self.count:
            where = publish(self._partial, self._path)
            self._note('WARN', f'a recorder was killed: its bag is repaired, {where} '
                               f'({self.count} messages)')
        else:
            self._file.unlink()
            if damage is None:
                self._note('INFO', 'a recorder was killed before it received anything')
        self.count = 0
        self._topics.clear()
        self._schemas.clear()
        self._custom.clear()

    def _copy(self, broken: Path) -> Damage | None:
        """Write the readable part of a broken file; return the damage that ends it, if any."""
        self._begin()
        stream, self._stream = self._stream, None
        assert stream is not None
        with stream:
            salvage = Salvage(broken)
            for topic, text, message in salvage:
                if topic.name not in self._topics:
                    self._topics[topic.name] = _Open(topic, text)
                self._put(topic.name, message.data, message.log_time, message.publish_time)
            self._writer.finish()
        return salvage.damage


class Damage(NamedTuple):
    """Where and why a file stops being readable."""

    place: int
    """Byte at which the damaged record begins."""
    error: Exception


class Salvage:
    """The messages of an MCAP file up to where it is cut short or damaged.

    Each comes with its topic and the text of its definition.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read a file."""
        self._path = path
        self.damage: Damage | None = None
        """Known after the last message. A last record that is merely cut short is no damage."""

    def __iter__(self) -> Iterator[tuple[Topic, str, Message]]:
        """Yield the messages.

        :raises OSError: when the file cannot be read; MemoryError: when there is no memory for it.
        """
        schemas: dict[int, Schema] = {}
        topics: dict[int, tuple[Topic, str]] = {}
        place = 0
        with self._path.open('rb') as stream:
            try:
                mcap_file.start(stream)
                while True:
                    place = stream.tell()
                    for record in mcap_file.records_at(stream, place):
                        if isinstance(record, Schema):
                            schemas[record.id] = record
                        elif isinstance(record, Channel):
                            schema = schemas[record.schema_id]
                            topics[record.id] = Topic(
                                record.topic, schema.name,
                                record.metadata.get('topic_type_hash', ''),
                                _offered(record.metadata)), schema.data.decode('utf-8')
                        elif isinstance(record, Message):
                            yield (*topics[record.channel_id], record)
            except MemoryError:
                raise
            except DAMAGED as error:
                if not mcap_file.is_cut(stream, place):
                    self.damage = Damage(place, error)


def _offered(metadata: Mapping[str, str]) -> tuple[Quality, ...]:
    """Return the offered qualities of service that a channel tells; none if it does not."""
    try:
        found = yaml.safe_load(metadata.get('offered_qos_profiles', '')) or []
        return tuple(Quality(**{
            name: one[name] for name in ('reliability', 'durability', 'history', 'depth')})
            for one in found)
    except (yaml.YAMLError, TypeError, KeyError):
        return ()


def publish(source: Path, path: Path, suffix: str = '') -> Path:
    """Rename a folder or file to `path`, or to the next free name: bag, bag-2 and so on.

    :param suffix: end of the name before which the number stands.
    :return: the resulting path.
    """
    for target in numbered(path, suffix):
        if os.path.lexists(target):
            continue
        try:
            source.rename(target)
        except OSError as error:
            if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
                continue  # it was made at this moment
            raise
        return target
    raise AssertionError
