# SPDX-License-Identifier: Apache-2.0
"""Plots of a training run, on a timeline of its own, and its log."""
from __future__ import annotations

import math
from array import array
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import timelines
from rocket_sim_node.telemetry.training_status import CURVES

LEARNING = ('demonstrate', 'clone', 'finetune')
"""Stages in which the agent learns; in the others it is evaluated."""


LINES = tuple(curve for curves in CURVES.values() for curve in curves)
"""The lines of all plots."""


@dataclass(frozen=True)
class Training:
    """An agent's report: one iteration of a stage, with its values by name."""

    stage: str
    iteration: int
    values: Mapping[str, float]
    message: str = ''
    run: str = ''
    """Name of the run."""

    @property
    def learning(self) -> bool:
        """Whether the agent is still learning."""
        return self.stage in LEARNING


def training_of(message: Any) -> Training:
    """Return the report in a message of type TrainingStatus, or in an object with its fields.

    Without a curriculum (level 0) it has no level curve.
    """
    values = {line.value: float(getattr(message, line.value)) for line in LINES}
    if not message.level:
        del values['level']
    return Training(message.stage, message.iteration, values, message.message, message.run)


class IterationCounter:
    """Counts iterations across stages, each of which begins its own count at 1."""

    def __init__(self) -> None:
        """Start before the first iteration."""
        self._stage = ('', '')
        self._before = 0
        self.count = 0

    def add(self, training: Training) -> int:
        """Return the iteration's number in the recording.

        An evaluation counts episodes, which are not added; another run continues the count.
        """
        if not training.learning:
            return self.count
        if (training.run, training.stage) != self._stage:
            self._stage, self._before = (training.run, training.stage), self.count
        self.count = self._before + training.iteration
        return self.count


def log_styles(stream: rr.RecordingStream) -> None:
    """Log names and colours of the curves."""
    for entity, curves in CURVES.items():
        stream.log(f'{entities.TRAINING}/{entity}', rr.SeriesLines(
            names=[curve.name for curve in curves], colors=[curve.colour for curve in curves],
            widths=[1.0 if curve.colour == palette.GREY else 2.0 for curve in curves],
        ), static=True)


class GatheredReports:
    """Buffer of iterations to be logged: their positions and their values of `LINES`.

    Stored as plain numbers: stored as objects they dominated a recorder's memory growth in its
    first hours, while the buffering period increases.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._timepoints, self._values = array('q'), array('d')

    def __len__(self) -> int:
        """Return the number of buffered iterations."""
        return len(self._timepoints) // 2

    def add(self, at: Timepoint, values: Mapping[str, float]) -> None:
        """Add an iteration; a missing value is a gap in its line."""
        row = array('d', [
            line.factor * values.get(line.value, math.nan) for line in LINES])
        self._timepoints += array('q', (at.step, at.iteration or 0))
        self._values += row

    def take(self) -> tuple[list[Timepoint], NDArray[np.float64]]:
        """Return positions and values `(k, lines)` of all iterations, and empty the buffer."""
        timepoints, values = self._timepoints, self._values
        self._timepoints, self._values = array('q'), array('d')
        return (
            [Timepoint(*pair) for pair in zip(timepoints[::2], timepoints[1::2], strict=True)],
            np.array(values).reshape(-1, len(LINES)))


def log_training(
    stream: rr.RecordingStream, timepoints: Sequence[
        Timepoint], values: NDArray[np.float64], dt: float,
) -> None:
    """Log several iterations at once: a chunk for each would cost more than its data.

    Values that are not finite are gaps in their line; a plot without values is omitted.

    :param values: `(k, lines)`, see :class:`GatheredReports`.
    """
    shown = np.where(np.isfinite(values), values, np.nan)
    ends = np.cumsum([len(curves) for curves in CURVES.values()])
    for entity, table in zip(CURVES, np.split(shown, ends[:-1], axis=1), strict=True):
        kept = np.flatnonzero(np.any(np.isfinite(table), axis=1)).tolist()
        if kept:
            stream.send_columns(
                f'{entities.TRAINING}/{entity}', times([timepoints[k] for k in kept], dt),
                rr.Scalars.columns(scalars=table[kept]))


def times(timepoints: Sequence[Timepoint], dt: float) -> list[rr.TimeColumn]:
    """Return the time columns of rows at `timepoints`."""
    steps = np.array([at.step for at in timepoints])
    return [
        rr.TimeColumn('iteration', sequence=[at.iteration or 0 for at in timepoints]),
        *timelines(steps, dt),
    ]


def log_stage(stream: rr.RecordingStream, name: str, at: Timepoint, dt: float) -> None:
    """Log that a stage of the run begins."""
    stream.send_columns(
        entities.TRAINING_STAGE, times([at], dt), rr.StateChange.columns(state=[name]))


def log_text(
    stream: rr.RecordingStream, rows: Sequence[tuple[Timepoint, str, str]], dt: float,
) -> None:
    """Log lines of the run's log: position, text and level ('INFO', 'WARN') of each."""
    stream.send_columns(
        entities.LOG, times([at for at, _, _ in rows], dt),
        rr.TextLog.columns(
            text=[text for _, text, _ in rows], level=[level for _, _, level in rows]))
