# SPDX-License-Identifier: Apache-2.0
"""Recordings for tests: written from given samples, and read by entity."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.timeline import Settle
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.capture import joined
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.base import SimulatedWorld

Pilot = Callable[[Telemetry, np.ndarray], np.ndarray]


def fly(world: str, rockets: int, steps: int, pilot: Pilot, **settings: Any) -> tuple[
        SimulatedWorld, Samples]:
    """Fly; return what a simulator publishes: all rows at each step, finished rows twice.

    :param pilot: maps telemetry and observation to actions.
    """
    simulated = make(world, rockets, 0, **settings)
    rows = np.arange(rockets)
    parts = [(0, simulated.telemetry(rows))]
    observation = simulated.observe()
    for step in range(1, steps + 1):
        observation = simulated.step(pilot(parts[-1][1], observation))[0]
        if len(simulated.finished.row):
            parts.append((step, simulated.finished))
        parts.append((step, simulated.telemetry(rows)))
    return simulated, joined(parts)


def record(
    path: Path, stage: WorldInfo, samples: Samples, settle: Settle | None = None,
    kind: type[Recorder] = Recorder, more: Sequence[tuple[WorldInfo, Samples]] = (),
) -> Recorder:
    """Record samples to a file, then `more` samples of other worlds, each as a new session."""
    recorder = kind(
        RecordingFilter(), [FileSink(path, lambda *note: None)], lambda *note: None, settle=settle)
    for session, (world, flown) in enumerate(((stage, samples), *more), 1):
        recorder.world(world)
        for start in range(0, len(flown.step), 100):
            recorder.states(session, flown.take(slice(start, start + 100)))
    recorder.close()
    return recorder


def rows_of(
    path: Path, entity: str, component: str, timeline: str = 'step',
) -> list[tuple[int, Any]]:
    """Return (step, value) of a component of an entity on a timeline, ordered by step."""
    rows: list[tuple[int, Any]] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path != entity:
            continue
        batch = chunk.to_record_batch()
        if component not in batch.schema.names or timeline not in batch.schema.names:
            continue
        rows += [row for row in zip(
            batch.column(timeline).to_pylist(), batch.column(component).to_pylist(), strict=True)
            if None not in row]
    return sorted(rows, key=lambda row: row[0])


def lines_of(path: Path, entity: str, name: str) -> list[tuple[int, list[float]]]:
    """Return (step, values of the lines) of a plot of a rocket's entity, ordered by step."""
    return [
        (step, records[0][name]) for step, records in rows_of(path, entity, plots.SAMPLE)]


def view_classes(path: Path) -> list[str]:
    """Return the kinds of views in the layout of a recording, sorted."""
    reader = RrdReader(path)
    kinds = []
    for chunk in reader.stream(store=reader.blueprints()[-1]):
        batch = chunk.to_record_batch()
        if 'ViewBlueprint:class_identifier' in batch.schema.names:
            kinds += [row[0] for row in batch.column('ViewBlueprint:class_identifier').to_pylist()]
    return sorted(kinds)
