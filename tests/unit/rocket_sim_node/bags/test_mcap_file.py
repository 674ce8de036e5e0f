# SPDX-License-Identifier: Apache-2.0
"""Untrusted MCAP files: memory is limited, and the order is that of the library's reader."""
from __future__ import annotations

import re
import resource
import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel
from mcap.records import Chunk
from mcap.records import Message
from mcap.records import Schema
from mcap.writer import CompressionType
from mcap.writer import Writer
from support.recording.bags import write_records

from rocket_sim_node.bags import bag_file
from rocket_sim_node.bags import mcap_file
from rocket_sim_node.bags.reader import messages

SCHEMA = Schema(data=b'string data', encoding='ros2msg', id=1, name='std_msgs/msg/String')
CHANNEL = Channel(id=1, topic='/said', message_encoding='cdr', metadata={}, schema_id=1)


def chunk(data: bytes, compression: str, claims: int) -> Chunk:
    return Chunk(compression, data, 0, 0, 0, claims)


def zstd_zeros(size: int, sized: bool) -> bytes:
    """Return compressed zeros; with their number in the frame or without."""
    compressor = zstandard.ZstdCompressor(write_content_size=sized).compressobj(
        size if sized else -1)
    block = bytes(1 << 20)
    parts = [compressor.compress(block) for _ in range(size >> 20)]
    return b''.join(parts) + compressor.flush()


GIBIBYTE = 2**30
HUGE_FRAME = b'\x28\xb5\x2f\xfd\xe0' + struct.pack('<Q', 2**50) + b'\x03\x00\x00\x00'
"""a frame of zstd that claims a pebibyte"""


@pytest.mark.parametrize(('compression', 'claims', 'words'), [
    ('zstd', GIBIBYTE, 'a chunk: got 1073741824 bytes when decompressed, expected at most'),
    ('zstd', 1000, 'a chunk claims 1000 bytes, and holds more'),
    ('zstd unsized', 1000, 'a chunk claims 1000 bytes, and holds more'),
    ('zstd huge', 1000, 'damaged'),
    ('lz4', 1000, 'a chunk claims 1000 bytes, and holds more'),
    ('lz4', 2**63, 'a chunk: got 9223372036854775808 bytes'),
    ('', 2**40, 'a chunk: got 1099511627776 bytes'),
    ('', 5, 'a chunk claims 5 bytes, and holds more'),
    ('bzip2', 5, 'unsupported compression type bzip2')])
def test_a_decompression_bomb_is_refused_and_takes_no_memory(
        tmp_path: Path, compression: str, claims: int, words: str) -> None:
    data = {
        'zstd': lambda: zstd_zeros(GIBIBYTE, sized=True),
        'zstd unsized': lambda: zstd_zeros(GIBIBYTE, sized=False),
        'zstd huge': lambda: HUGE_FRAME,
        'lz4': lambda: lz4.frame.compress(bytes(64 << 20)),
    }.get(compression, lambda: bytes(1000))()
    path = write_records(tmp_path / 'it.mcap', [
        SCHEMA, CHANNEL, chunk(data, compression.partition(' ')[0], claims)])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=re.escape(words)) as refused:
        list(messages(path))
    assert str(refused.value).startswith(f'{path}: ')
    assert '\n' not in str(refused.value)
    assert list(bag_file.Salvage(path)) == []
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 << 10, 'KiB'


def test_many_chunks_are_limited_together(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    builder = RecordBuilder()
    for number in range(100):
        Message(1, 10**18 + number, bytes(1000), 0, number).write(builder)
    inner = builder.end()
    path = write_records(tmp_path / 'it.mcap', [SCHEMA, CHANNEL, *(
        chunk(zstandard.compress(inner), 'zstd', len(inner)) for _ in range(10))])
    with path.open('rb') as stream:
        assert len(list(mcap_file.messages(stream))) == 1000
        monkeypatch.setattr(mcap_file, 'MOST_WAITING', 500_000)
        with pytest.raises(mcap_file.TooLarge, match='messages of overlapping chunks'):
            list(mcap_file.messages(stream))
        monkeypatch.setattr(mcap_file, 'LARGEST_TOTAL', 500_000)
        with pytest.raises(mcap_file.TooLarge, match='its chunks: got'):
            list(mcap_file.messages(stream))


def test_the_message_list_of_a_file_without_chunks_is_limited(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_records(tmp_path / 'it.mcap', [SCHEMA, CHANNEL, *(
        Message(1, 1000 - number, b'x', 0, number) for number in range(100))])
    with path.open('rb') as stream:
        found = [message.log_time for _, _, message in mcap_file.messages(stream)]
        assert found == list(range(901, 1001))
        monkeypatch.setattr(mcap_file, 'MOST_WAITING', 30_000)
        with pytest.raises(mcap_file.TooLarge, match='a list of its messages'):
            list(mcap_file.messages(stream))


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('topics', [None, ['/b']])
@pytest.mark.parametrize('summary', [True, False])
def test_messages_have_the_order_of_the_library(
        tmp_path: Path, compression: CompressionType, topics: list[str] | None, summary: bool,
) -> None:
    path = tmp_path / 'it.mcap'
    random = np.random.default_rng(3)
    with path.open('wb') as stream:
        writer = Writer(
            stream, chunk_size=2000, compression=compression, repeat_channels=summary,
            repeat_schemas=summary, use_statistics=summary, use_summary_offsets=summary)
        writer.start('ros2', 'test')
        schema = writer.register_schema('a/msg/A', 'ros2msg', b'')
        channels = [writer.register_channel(name, 'cdr', schema) for name in ('/a', '/b')]
        for number in range(300):
            writer.add_message(
                channels[number % 2], number * 10 + int(random.integers(0, 300)),
                random.bytes(30), number)
        writer.finish()
    with path.open('rb') as stream:
        ours = list(mcap_file.messages(stream, topics))
    assert [message.log_time for _, _, message in ours] == sorted(
        message.log_time for _, _, message in ours) or not summary
    assert len(ours) == 300 if topics is None else 150
    if summary:
        with path.open('rb') as stream:
            assert ours == list(make_reader(stream).iter_messages(topics))
