# SPDX-License-Identifier: Apache-2.0
"""Reader that returns the flights of a recording as arrays."""
from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
from numpy.typing import NDArray

from rocket_sim_node import input_file
from rocket_sim_node.frames import to_world
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.sinks.base import APPLICATION
from rocket_sim_node.recording.sinks.rrd_file import opened
from rocket_sim_node.recording.trajectories.trajectory import tilt_of

F32 = NDArray[np.float32]
LARGEST = 8 * 2**30
"""Maximum bytes of a recording: 80 million steps, 400 times `max_steps` of the recorder."""
EMPTY: F32 = np.zeros((0, 0), np.float32)
ARROW = 0.9
"""m of velocity arrow per m/s, in recordings that do not store it."""


@dataclass(frozen=True)
class RecordedTrajectory:
    """One recorded flight: n samples, z up, SI units, float32 as stored.

    `time` `(n,)` s since it began, `start` s on the recording's `sim_time`; `position` and
    `velocity` `(n, 3)`; `orientation` `(n, 4)` x y z w, body to world, and the derived `tilt`,
    deg; `throttle` 0 to 1, `fuel` kg (meaningless in worlds without fuel) and `reward` of the step
    that led there (0 for the first, NaN if not recorded) `(n,)`. `summary` holds row, episode,
    return and other results. `pilot` is the pilot's key in a comparison.
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
    pilot: str = ''


def trajectories(path: Path | str) -> list[RecordedTrajectory]:
    """Return the flights of a recording in order, even if they are of several worlds.

    :raises OSError: when there is no such file, or it is not one of our recordings.
    :raises ValueError: when it is not a regular file, or too large.
    """
    if not Path(path).exists():
        raise FileNotFoundError(2, 'no such recording', str(path))
    input_file.check(Path(path), LARGEST)
    rockets: dict[str, list[pa.RecordBatch]] = {}
    landings: dict[str, list[pa.RecordBatch]] = {}
    try:
        recording = opened(path)
        if not any(one.application_id.startswith(APPLICATION) for one in recording.recordings()):
            raise OSError(22, 'not a recording of flights', str(path))
        for chunk in recording.stream():
            for entity, tables in ((entities.ROCKET, rockets), (entities.LANDINGS, landings)):
                # A comparison has one copy of the scene per pilot, below the pilot's key.
                if chunk.entity_path.endswith(entity) and 'step' in chunk.timeline_names:
                    pilot = chunk.entity_path.removesuffix(entity).strip('/')
                    tables.setdefault(pilot, []).append(chunk.to_record_batch())
    except (RuntimeError, ValueError) as error:
        raise OSError(22, f'not a readable recording: {error}', str(path)) from error
    flights = [
        flight for pilot in rockets
        for flight in _flights(pilot, rockets[pilot], landings.get(pilot, []))]
    return sorted(flights, key=lambda flight: (flight.summary['first_step'], flight.pilot))


def _flights(
    pilot: str, rockets: list[pa.RecordBatch], landings: list[pa.RecordBatch],
) -> list[RecordedTrajectory]:
    """Return the flights of one pilot."""
    step = np.concatenate([_column(batch, 'step') for batch in rockets])
    order = np.argsort(step, kind='stable')
    step = step[order]
    names = {name for batch in rockets for name in batch.schema.names if ':' in name}
    columns = {
        name: pa.concat_arrays([_cells(batch, name, rockets) for batch in rockets]).take(
            pa.array(order))
        for name in names}
    flights = []
    for batch in landings:
        records = (items[0] for items in batch.column('Episode:summary').to_pylist())
        for record, end in zip(records, _column(batch, 'sim_time') / 1e9, strict=True):
            first, count = int(np.searchsorted(step, record['first_step'])), record['samples']
            # Converted flight by flight: rows of another world may have more values.
            flights.append(_trajectory(record, float(end), pilot, {
                name: _numbers(values, count)
                for component, column in columns.items()
                for name, values in _fields(component, column.slice(first, count))}))
    return flights


def _fields(component: str, cells: pa.Array) -> Iterator[tuple[str, pa.Array]]:
    """Yield a component, or each field of it if it holds records, as `<archetype>:<field>`."""
    if not pa.types.is_struct(cells.type.value_type):
        yield component, cells
        return
    records = cells.flatten()
    for field in records.type:
        yield f'{component.split(":")[0]}:{field.name}', records.field(field.name)


def _cells(batch: pa.RecordBatch, name: str, batches: list[pa.RecordBatch]) -> pa.Array:
    """Return a component, a list in each row; empty lists for a batch without it."""
    if name in batch.schema.names:
        return batch.column(name)
    kind = next(b.schema.field(name).type for b in batches if name in b.schema.names)
    return pa.nulls(batch.num_rows, kind)


def _trajectory(
    record: dict[str, Any], end: float, pilot: str, part: dict[str, F32],
) -> RecordedTrajectory:
    count = record['samples']
    seconds = np.arange(count) * record['dt']
    orientation = part['Transform3D:quaternion']
    tank = np.float32(record['tank'])
    fuel, reward = np.zeros(count, np.float32), np.full(count, np.nan, np.float32)
    if part.get('Flight:engine', EMPTY).size:
        throttle, fuel = part['Flight:engine'].T
        fuel = fuel * (tank / np.float32(100))
        reward = part['Flight:reward'][:, 1]
    else:  # of a comparison, one line per plot
        throttle = part['Flight:throttle'][:, 0]
        if part.get('Flight:fuel_used', EMPTY).size:
            fuel = np.float32(_start_fuel(record)) - part['Flight:fuel_used'][:, 0]
        if part.get('Flight:return', EMPTY).size:
            reward = np.diff(part['Flight:return'][:, 0], prepend=np.float32(0))
    return RecordedTrajectory(
        row=record['row'], episode=record['episode'], outcome=record['outcome'],
        start=end - float(seconds[-1]), time=seconds.astype(np.float32),
        position=part['Transform3D:translation'], orientation=orientation,
        velocity=_velocity(orientation, part['Arrows3D:vectors'][:, :3], record),
        tilt=tilt_of(orientation.astype(np.float64)).astype(np.float32),
        throttle=throttle / np.float32(100), fuel=fuel, reward=reward, summary=record, pilot=pilot)


def _start_fuel(record: dict[str, Any]) -> float:
    """Return the fuel at the start of a flight, kg, also if an older recording lacks it."""
    conditions = json.loads(record.get('conditions') or '{}')
    default = record['tank'] * conditions.get('fuel_factor', 1.0)
    return float(record.get('start_fuel', default))


def _column(batch: pa.RecordBatch, name: str) -> NDArray[np.int64]:
    """Return a timeline `(rows,)`; sequences unchanged, durations in ns."""
    return np.asarray(batch.column(name).cast('int64').to_numpy(zero_copy_only=False))


def _numbers(array: pa.Array, rows: int) -> F32:
    """Return a component with k numbers in every row, `(rows, k)`; k is 0 if it is missing."""
    while hasattr(array, 'flatten') and array.type.num_fields:
        array = array.flatten()
    if pa.types.is_null(array.type) or not len(array):
        return np.zeros((rows, 0), np.float32)
    return np.asarray(array.to_numpy(zero_copy_only=False), np.float32).reshape(rows, -1)


def _velocity(orientation: F32, arrow: F32, record: dict[str, Any]) -> F32:
    """Return the velocity `(n, 3)` from its arrow in the body frame."""
    world = to_world(orientation.astype(np.float64), arrow.astype(np.float64))
    return np.asarray(world / record.get('arrow', ARROW), np.float32)
