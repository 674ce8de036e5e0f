# SPDX-License-Identifier: Apache-2.0
"""Flights read back from a recording, as arrays."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from rocket_sim_node.recording import scene

F32 = NDArray[np.float32]
ARROW = 0.9
"""m of velocity arrow per m/s in recordings that do not say it"""


@dataclass(frozen=True)
class Trajectory:
    """One recorded flight: n samples, z up, SI units, float32 as they are stored.

    `time` `(n,)` s since it began, `start` s on the recording's `sim_time`; `position` and
    `velocity` `(n, 3)`; `orientation` `(n, 4)` x y z w, body to world; `tilt` deg, `throttle`
    0 to 1, `fuel` kg and `reward` of the step that led there (0 for the first) `(n,)`. `summary`
    holds row, episode, return and what else is known of the end.
    """

    row: int
    episode: int
    outcome: str
    start: float
    time: F32
    position: F32
    velocity: F32
    orientation: F32
    tilt: F32
    throttle: F32
    fuel: F32
    reward: F32
    summary: dict[str, Any]


def trajectories(path: Path | str) -> list[Trajectory]:
    """Return the flights of a recording in their order.

    :raises OSError: when there is no such file, or it is none of ours.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(2, 'no such recording', str(path))
    tables: dict[str, list[Any]] = {scene.ROCKET: [], scene.LANDINGS: []}
    try:
        for chunk in RrdReader(path).stream():
            if chunk.entity_path in tables and 'step' in chunk.timeline_names:
                tables[chunk.entity_path].append(chunk.to_record_batch())
    except (RuntimeError, ValueError) as error:
        raise OSError(22, f'not a readable recording: {error}', str(path)) from error
    if not tables[scene.ROCKET]:
        return []
    step = np.concatenate([_column(batch, 'step') for batch in tables[scene.ROCKET]])
    order = np.argsort(step, kind='stable')
    step = step[order]

    def values(name: str) -> F32:
        parts = [_numbers(batch, name) for batch in tables[scene.ROCKET]]
        return np.concatenate(parts)[order]

    columns = {
        'position': values('Transform3D:translation'),
        'orientation': values('Transform3D:quaternion'),
        'arrows': values('Arrows3D:vectors'), 'tilt': values('Flight:tilt'),
        'engine': values('Flight:engine'), 'reward': values('Flight:reward'),
    }
    summaries = [
        (record, seconds)
        for batch in tables[scene.LANDINGS]
        for record, seconds in zip(
            (items[0] for items in batch.column('Episode:summary').to_pylist()),
            _column(batch, 'sim_time') / 1e9, strict=True)]
    summaries.sort(key=lambda item: int(item[0]['first_step']))
    flights = []
    for record, end in summaries:
        first = int(np.searchsorted(step, record['first_step']))
        part = {
            name: column[first:first + record['samples']] for name, column in columns.items()}
        flights.append(_trajectory(record, float(end), part))
    return flights


def _trajectory(record: dict[str, Any], end: float, part: dict[str, F32]) -> Trajectory:
    count = record['samples']
    seconds = np.arange(count) * record['dt']
    return Trajectory(
        row=record['row'], episode=record['episode'], outcome=record['outcome'],
        start=end - float(seconds[-1]), time=seconds.astype(np.float32),
        position=part['position'], orientation=part['orientation'],
        velocity=_to_world(part['orientation'], part['arrows'][:, :3]) / np.float32(
            record.get('arrow', ARROW)),
        tilt=part['tilt'][:, 0], throttle=part['engine'][:, 0] / np.float32(100),
        # Where no fuel is burnt the second line is another.
        fuel=part['engine'][:, 1] * np.float32(record['tank'] / 100.0),
        reward=part['reward'][:, 1], summary=record)


def _column(batch: pa.RecordBatch, name: str) -> NDArray[np.int64]:
    """Return a timeline `(rows,)`, sequences as they are and durations in ns."""
    return np.asarray(batch.column(name).cast('int64').to_numpy(zero_copy_only=False))


def _numbers(batch: pa.RecordBatch, name: str) -> F32:
    """Return a component with k numbers in every row, `(rows, k)`."""
    array = batch.column(name)
    while hasattr(array, 'flatten') and array.type.num_fields:
        array = array.flatten()
    return np.asarray(array.to_numpy(zero_copy_only=False), np.float32).reshape(batch.num_rows, -1)


def _to_world(quaternion: F32, vector: F32) -> F32:
    """Return body vectors `(n, 3)` in the world, for attitudes `(n, 4)`."""
    axis, real = quaternion[:, :3], quaternion[:, 3:]
    twice = 2 * np.cross(axis, vector)
    return np.asarray(vector + real * twice + np.cross(axis, twice), np.float32)
