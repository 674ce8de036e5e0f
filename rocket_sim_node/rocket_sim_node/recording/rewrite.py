# SPDX-License-Identifier: Apache-2.0
"""A finished recording written anew: fewer, larger chunks, and the layout that fits it."""
from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import ChunkStore
from rerun.chunk import OptimizationProfile
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

from rocket_sim_node.recording import scene
from rocket_sim_node.recording.blueprint import blueprint

LARGE_CHUNKS = dataclasses.replace(OptimizationProfile.OBJECT_STORE, split_size_ratio=None)
"""what was logged together stays together: each chunk costs the index a kilobyte or two"""


def rewrite(source: Path, target: Path, tab: str = 'flight') -> None:
    """Write the recording in `source` to `target`, under the same identity.

    A file as it was recorded has some chunks for each flight; joined, it is smaller and opens
    quicker. It gets the tab for training when there was one.

    :param tab: the one in front.
    :raises OSError: when `source` cannot be read.
    """
    try:
        reader = RrdReader(source)
        store = joined(reader)
        trained = any(
            path.startswith(scene.TRAINING) for path in store.schema().entity_paths())
        world = _world(reader)
    except (RuntimeError, ValueError, IndexError) as error:
        raise OSError(22, f'not a readable recording: {error}', str(source)) from error
    save(reader, store, target, blueprint(training=trained, tab=tab, world=world))


def finished(path: Path) -> bool:
    """Return whether a recording was written to its end, where its table of contents is."""
    with warnings.catch_warnings():
        # Without one it is read all the same, and warned of.
        warnings.simplefilter('error', RerunWarning)
        try:
            RrdReader(path)
        except (RuntimeError, ValueError, RerunWarning):
            return False
    return True


def joined(reader: RrdReader) -> ChunkStore:
    """Return all of a recording in fewer, larger chunks."""
    return reader.stream().collect(optimize=LARGE_CHUNKS)


def save(reader: RrdReader, store: ChunkStore, target: Path, layout: rrb.Blueprint) -> None:
    """Write chunks to a file, under the identity of the recording that they are from."""
    entry = reader.recordings()[0]
    stream = rr.RecordingStream(
        entry.application_id, recording_id=entry.recording_id, send_properties=False)
    stream.save(target, default_blueprint=layout)
    stream.send_chunks(store)
    stream.flush(timeout_sec=30.0)
    stream.disconnect()


def _world(reader: RrdReader) -> str:
    """Return the name of the world that was recorded last, empty when it is not said."""
    for chunk in reader.stream():
        if chunk.entity_path == scene.WORLD and chunk.is_static:
            batch = chunk.to_record_batch()
            if scene.WORLD_NAME in batch.schema.names:
                return str(batch.column(scene.WORLD_NAME).to_pylist()[-1][0])
    return ''
