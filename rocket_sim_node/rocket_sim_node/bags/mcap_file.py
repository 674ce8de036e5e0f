# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file in the order of their times, in no more memory than a limit.

The readers of package mcap decompress a chunk to the size that it names, of terabytes if need be,
and keep all messages of chunks whose times overlap. A file may come from a stranger, so here each
size is checked before memory is taken for it, and again against what comes out.
"""
from __future__ import annotations

import os
import struct
from collections.abc import Collection
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from heapq import heapify
from heapq import heappop
from heapq import heappush
from io import BytesIO
from typing import BinaryIO
from typing import NamedTuple

from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.exceptions import McapError
from mcap.exceptions import UnsupportedCompressionError
from mcap.opcode import Opcode
from mcap.records import Channel
from mcap.records import Chunk
from mcap.records import McapRecord
from mcap.records import Message
from mcap.records import Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.stream_reader import read_magic
from zstandard import ZstdDecompressor

LARGEST_RECORD = 256 * 2**20
"""Maximum bytes of a record; of a chunk also when it is decompressed."""
LARGEST_TOTAL = 64 * 2**30
"""Maximum bytes of all chunks when they are decompressed."""
_MOST_CUT = 4 * 2**20
"""Maximum bytes of a record, other than a chunk, that a kill cuts short."""
MOST_WAITING = 2**30
"""Maximum bytes of memory for messages that wait for earlier ones."""
_OVERHEAD = 400
"""Bytes of memory of a message without its content."""
_HEAD = struct.Struct('<BQ')
_CHUNK_HEAD = struct.Struct('<QQQ')
_CHUNK_SIZES = struct.Struct('<QQQII')
"""First fields of a chunk; the last one is the length of the name of its compression."""
_SIZE = struct.Struct('<Q')
_MESSAGE_HEAD = struct.Struct('<HIQQ')


class TooLarge(McapError):
    """A file takes, or claims to take, more memory than any sane one."""


class _Waiting(NamedTuple):
    """A message, or a chunk or message that has not been read yet; they are sorted by time."""

    time: int
    place: int
    number: int
    message: Message | None


@dataclass
class _Contents:
    """Contents of a file that are known before its messages are read."""

    waiting: list[_Waiting] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def define(self, record: McapRecord) -> None:
        """Note a schema or a channel."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record


def messages(
    stream: BinaryIO, topics: Collection[str] | None = None,
) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """Yield the messages of a file by the time at which they were received.

    :param topics: names of the topics wanted; None: all.
    :raises Exception: one of `read_errors.DAMAGED`, when the file is cut short, damaged or too
        large.
    """
    found = _contents(stream)
    waiting, memory = found.waiting, _OVERHEAD * len(found.waiting)
    while waiting:
        one = heappop(waiting)
        message = one.message
        if message is not None:
            memory -= _OVERHEAD + len(message.data)
        else:
            memory -= _OVERHEAD
            record = _read(stream, one.place)
            if isinstance(record, Chunk):
                for number, inner in enumerate(unpacked(record)):
                    found.define(inner)
                    if isinstance(inner, Message) and (
                            topics is None or found.channels[inner.channel_id].topic in topics):
                        memory += _OVERHEAD + len(inner.data)
                        _check(memory, MOST_WAITING, 'messages of overlapping chunks')
                        heappush(waiting, _Waiting(inner.log_time, one.place, number, inner))
                continue
            assert isinstance(record, Message)
            message = record
        channel = found.channels[message.channel_id]
        if topics is None or channel.topic in topics:
            yield (found.schemas[channel.schema_id] if channel.schema_id else None, channel,
                   message)


def start(stream: BinaryIO) -> None:
    """Go to the first record of a file.

    :raises Exception: one of `read_errors.DAMAGED`, when it is not an MCAP file.
    """
    stream.seek(0)
    read_magic(ReadDataStream(stream))


def records_at(stream: BinaryIO, place: int) -> Iterator[McapRecord]:
    """Yield the schemas, channels and messages of the record at an offset, and go past it.

    :raises Exception: one of `read_errors.DAMAGED`, when it is cut short, damaged or too large.
    """
    record = _read(stream, place)
    if isinstance(record, Chunk):
        yield from unpacked(record)
    elif record is not None:
        yield record


def is_cut(stream: BinaryIO, place: int) -> bool:
    """Return whether a file merely ends within the record at an offset, as after a kill."""
    left = os.fstat(stream.fileno()).st_size - place
    if left < _HEAD.size:
        return True
    stream.seek(place)
    opcode, length = _HEAD.unpack(_exactly(stream, _HEAD.size))
    left -= _HEAD.size
    if not (place > 0 and left < length <= LARGEST_RECORD):
        return False
    if opcode != Opcode.CHUNK:
        return left <= _MOST_CUT
    # The length may be what is damaged. A chunk tells it twice.
    if left < _CHUNK_SIZES.size:
        return True
    *_, name = _CHUNK_SIZES.unpack(_exactly(stream, _CHUNK_SIZES.size))
    if left < (head := _CHUNK_SIZES.size + name + _SIZE.size):
        return True
    stream.seek(name, os.SEEK_CUR)
    return bool(length == head + _SIZE.unpack(_exactly(stream, _SIZE.size))[0])


def unpacked(chunk: Chunk) -> Iterator[McapRecord]:
    """Yield the schemas, channels and messages of a chunk.

    :raises Exception: as `messages` does.
    """
    size = chunk.uncompressed_size
    _check(size, LARGEST_RECORD, 'a chunk')
    # One byte more shows that there is more than the chunk claims.
    if chunk.compression == 'zstd':
        with ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression == 'lz4':
        try:
            data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        except RuntimeError as error:
            raise McapError(str(error)) from error
    elif chunk.compression:
        raise UnsupportedCompressionError(chunk.compression)
    else:
        data = chunk.data
    if len(data) != size:
        raise McapError(f'a chunk claims {size} bytes, and holds '
                        f'{"more" if len(data) > size else len(data)}')
    stream, _ = get_chunk_data_stream(
        replace(chunk, compression='', data=data), validate_crc=True)
    while stream.count < size:
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        body = stream.read(length)
        if len(body) != length:
            raise EndOfFile(f'cut short: a record of {len(body)} bytes, expected {length}')
        record = _parse(opcode, body)
        if record is not None:
            yield record


def _contents(stream: BinaryIO) -> _Contents:
    """Return what a file holds, without its messages."""
    start(stream)
    end = os.fstat(stream.fileno()).st_size
    found, total = _Contents(), 0
    while True:
        place = stream.tell()
        opcode, length = _HEAD.unpack(_exactly(stream, _HEAD.size))
        if place + _HEAD.size + length > end:
            raise EndOfFile(f'cut short: {end} bytes, expected {place + _HEAD.size + length}')
        if opcode == Opcode.FOOTER:
            break
        if opcode == Opcode.CHUNK:
            begin, _, size = _CHUNK_HEAD.unpack(_exactly(stream, _CHUNK_HEAD.size))
            _check(size, LARGEST_RECORD, 'a chunk')
            total += size
            _check(total, LARGEST_TOTAL, 'its chunks')
            found.waiting.append(_Waiting(begin, place, 0, None))
        elif opcode == Opcode.MESSAGE:
            _, _, time, _ = _MESSAGE_HEAD.unpack(_exactly(stream, _MESSAGE_HEAD.size))
            found.waiting.append(_Waiting(time, place, 0, None))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = _read(stream, place)
            assert record is not None
            found.define(record)
        _check(_OVERHEAD * len(found.waiting), MOST_WAITING, 'a list of its messages')
        stream.seek(place + _HEAD.size + length)
    if not found.channels:  # they are in chunks, before the first message that needs them
        found.waiting = [one._replace(time=0) for one in found.waiting]
    heapify(found.waiting)
    return found


def _exactly(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise EndOfFile('cut short')
    return data


def _read(stream: BinaryIO, place: int) -> McapRecord | None:
    stream.seek(place)
    opcode, length = _HEAD.unpack(_exactly(stream, _HEAD.size))
    _check(length, LARGEST_RECORD, 'a record')
    return _parse(opcode, _exactly(stream, length))


def _parse(opcode: int, data: bytes) -> McapRecord | None:
    """Return a record of the kinds that are read here; None for others."""
    stream = ReadDataStream(BytesIO(data))
    record: McapRecord | None = None
    if opcode == Opcode.MESSAGE:
        record = Message.read(stream, len(data))
    elif opcode == Opcode.CHANNEL:
        record = Channel.read(stream)
    elif opcode == Opcode.SCHEMA:
        record = Schema.read(stream)
    elif opcode == Opcode.CHUNK:
        record = Chunk.read(stream)
    elif not opcode:
        raise McapError('a record of kind 0, which there is not')
    return record


def _check(size: int, most: int, what: str) -> None:
    """Refuse a size.

    :raises TooLarge: when it is larger than `most`.
    """
    if size > most:
        raise TooLarge(f'{what}: got {size} bytes when decompressed, expected at most {most}')
