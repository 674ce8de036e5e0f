# SPDX-License-Identifier: Apache-2.0
"""Rewriting of a finished recording with fewer, larger chunks and a matching layout."""
from __future__ import annotations

import dataclasses
from collections.abc import Collection
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import ChunkStore
from rerun.chunk import OptimizationProfile
from rerun.chunk import RrdReader

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.scene.blueprint import blueprint
from rocket_sim_node.recording.sinks.rrd_file import flush
from rocket_sim_node.recording.sinks.rrd_file import opened
from rocket_sim_node.recording.sinks.rrd_file import written

LARGE_CHUNKS = dataclasses.replace(OptimizationProfile.OBJECT_STORE, split_size_ratio=None)
"""Data logged together stays together: each chunk adds one or two kilobytes to the index."""
FLUSHED = 50
"""Maximum number of unwritten chunks while a recording is copied."""


def rewrite(source: Path, target: Path, tab: str = 'flight') -> None:
    """Write the recording in `source` to `target`, under the same identity.

    A file as recorded has several chunks for each flight; joined, it is smaller and opens faster.
    The layout has tabs for training and conditions if the recording contains any.

    :param tab: the one in front.
    :raises OSError: when `source` cannot be read or `target` cannot be written.
    """
    with _os_error('not a readable recording', source):
        reader = opened(source)
        store = joined(reader)
        further = _further_tabs(store.schema().entity_paths())
        world = _world(reader)
    with _os_error('could not be written', target):
        save(reader, store, target, blueprint(
            training='training' in further, unusual='conditions' in further, tab=tab,
            world=world))


def add_contents(source: Path, target: Path, layout: rrb.Blueprint) -> None:
    """Copy the recording in `source`, which has no table of contents, to `target` with one.

    A viewer needs it to navigate a large file. Only little of the file is in memory at a time.

    :raises OSError: when `source` cannot be read or `target` cannot be written.
    """
    with _os_error(f'could not be copied to {target.name}', source):
        reader = opened(source)
        stream = _stream(reader, target, layout)
        with written(stream, target):
            for number, chunk in enumerate(reader.stream()):
                stream.send_chunks(chunk)
                if not number % FLUSHED:
                    flush(stream)


def tabs(path: Path) -> list[str]:
    """Return which of :data:`blueprint.TABS` the layout of a recording has.

    :raises OSError: when it cannot be read.
    """
    with _os_error('not a readable recording', path):
        paths = {chunk.entity_path for chunk in opened(path).stream()}
    return ['flight', 'log', *_further_tabs(paths)]


def _further_tabs(paths: Collection[str]) -> list[str]:
    """Return the tabs that only recordings with some entities have."""
    trained = any(path.startswith(entities.TRAINING) for path in paths)
    return ['training'] * trained + ['conditions'] * (entities.CONDITIONS in paths)


def is_empty(path: Path) -> bool:
    """Return whether a recording has only a layout and its own properties.

    :raises OSError: when it cannot be read.
    """
    with _os_error('not a readable recording', path):
        return all(
            chunk.entity_path.startswith('/__properties') for chunk in opened(path).stream())


@contextmanager
def _os_error(what: str, path: Path) -> Iterator[None]:
    """Convert Rerun's errors to OSError."""
    try:
        yield
    except (RuntimeError, ValueError, IndexError) as error:
        raise OSError(22, f'{what}: {error}', str(path)) from error


def joined(reader: RrdReader) -> ChunkStore:
    """Return all data of a recording in fewer, larger chunks."""
    return reader.stream().collect(optimize=LARGE_CHUNKS)


def save(reader: RrdReader, store: ChunkStore, target: Path, layout: rrb.Blueprint) -> None:
    """Write chunks to a file, under the identity of the recording that they are from.

    :raises RuntimeError: when not all could be written.
    """
    stream = _stream(reader, target, layout)
    with written(stream, target):
        stream.send_chunks(store)


def _stream(reader: RrdReader, target: Path, layout: rrb.Blueprint) -> rr.RecordingStream:
    entry = reader.recordings()[0]
    stream = rr.RecordingStream(
        entry.application_id, recording_id=entry.recording_id, send_properties=False)
    stream.save(target, default_blueprint=layout)
    return stream


def _world(reader: RrdReader) -> str:
    """Return the name of the last recorded world, empty if there is none."""
    for chunk in reader.stream():
        if chunk.entity_path == entities.WORLD and chunk.is_static:
            batch = chunk.to_record_batch()
            if entities.WORLD_NAME in batch.schema.names:
                return str(batch.column(entities.WORLD_NAME).to_pylist()[-1][0])
    return ''
