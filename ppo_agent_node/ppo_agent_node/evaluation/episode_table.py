# SPDX-License-Identifier: Apache-2.0
"""Table of an evaluation's episodes in a file, `episodes.csv`: one line per episode.

Column names include units. A cell is empty if there is no value: fuel in a world without fuel, the
motion after a touchdown if there was none. Numbers have ten digits.
"""
from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.evaluation.optimum_sample import OptimumSample
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.starts import initial_conditions
from rocket_sim_node import input_file
from rocket_sim_node.worlds.base import F64

LARGEST = 2**30
"""Maximum bytes; an episode takes one or two hundred."""
START = 'start_'
"""Name prefix of columns with initial conditions, which depend on the world."""
OPTIMUM = ('optimum_fuel_kg', 'optimum_steps')
"""Minimum fuel and length, for the sample of episodes that was solved; not in every table."""
_DIGITS = '.10g'


class _Column(NamedTuple):
    name: str
    words: bool
    """Whether it contains words, not numbers."""


COLUMNS = tuple(_Column(name, name in ('outcome', 'after_touchdown')) for name in (
    'row', 'episode', 'outcome', 'return', 'length_steps', 'touchdown_speed_m_s', 'tilt_deg',
    'distance_m', 'fuel_used_kg', 'fuel_bound_kg', 'end_x_m', 'end_z_m', 'standing',
    'after_touchdown', 'fuel_left_kg', 'hover_time_s', 'ignitions', 'control_effort'))
"""`standing` is 1 for rockets that stand in the end, 0 for others, empty if being at rest is what
landed means; `after_touchdown` is the verdict of the contact model that continues `rocket`."""
_LATER = ('fuel_left_kg', 'hover_time_s', 'ignitions', 'control_effort')
"""Columns that tables of earlier versions lack; they are read as empty."""


@dataclass(frozen=True)
class EpisodeTable:
    """K episodes in order of row, then of flight."""

    numbers: dict[str, F64]
    """`(K,)` by column name, NaN for an empty cell."""
    words: dict[str, tuple[str, ...]]
    """K by column name, '' for an empty cell."""

    def __len__(self) -> int:
        """Return K."""
        return len(self.words['outcome'])

    def named(self, *outcomes: str) -> NDArray[np.bool_]:
        """Return `(K,)` whether episodes had one of these outcomes."""
        return np.array([outcome in outcomes for outcome in self.words['outcome']], np.bool_)

    @property
    def starts(self) -> dict[str, F64]:
        """Initial conditions, `(K,)` by column name."""
        return {name: values for name, values in self.numbers.items() if name.startswith(START)}


def from_result(result: EvaluationResult, optimum: OptimumSample | None = None) -> EpisodeTable:
    """Return the episodes of an evaluation as a table.

    :param optimum: of its first episodes.
    """
    flown, count = result.episodes, len(result.episodes)
    unknown = np.full(count, np.nan)
    standing = unknown if result.standing is None else result.standing.astype(np.float64)
    of_rockets = {
        'fuel_used_kg': flown.fuel_used, 'fuel_left_kg': flown.fuel_left,
        'hover_time_s': flown.hover_time, 'ignitions': flown.ignitions.astype(np.float64),
        'control_effort': flown.control_effort}
    return EpisodeTable(
        numbers={
            'row': flown.row.astype(np.float64), 'episode': flown.episode.astype(np.float64),
            'return': flown.episode_return, 'length_steps': flown.length.astype(np.float64),
            'touchdown_speed_m_s': flown.touchdown_speed, 'tilt_deg': np.rad2deg(flown.tilt),
            'distance_m': flown.distance,
            'fuel_bound_kg': result.fuel_bound, 'end_x_m': result.end_position[:, 0],
            'end_z_m': result.end_position[:, 1], 'standing': standing,
            **{name: values if result.is_rocket else unknown
               for name, values in of_rockets.items()},
            **initial_conditions(result.spec, result.first_observation, result.settings),
            **_optimum(optimum, count)},
        words={
            'outcome': tuple(result.spec.outcomes[code] for code in flown.outcome.tolist()),
            'after_touchdown': (
                ('',) * count if result.settled is None else result.settled.verdict)})


def _optimum(optimum: OptimumSample | None, count: int) -> dict[str, F64]:
    """Return the columns of the optimum, `(K,)` each; none if nothing was solved."""
    if optimum is None or not len(optimum.fuel):
        return {}
    columns = zip(OPTIMUM, (optimum.fuel, optimum.steps), strict=True)
    return {name: np.append(values, np.full(count - len(values), np.nan))
            for name, values in columns}


def write(path: Path, table: EpisodeTable) -> None:
    """Write a table atomically: a reader finds the old file or the complete new one.

    :raises OSError: naming the path; nothing changes.
    """
    cells: dict[str, Sequence[str]] = {
        name: [format(value, _DIGITS) if value == value else '' for value in values.tolist()]
        for name, values in table.numbers.items()}
    cells |= table.words
    names = [*(column.name for column in COLUMNS), *table.starts,
             *(name for name in OPTIMUM if name in table.numbers)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(names)
    writer.writerows(zip(*(cells[name] for name in names), strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.getvalue().encode())


def read(path: Path) -> EpisodeTable:
    """Return a table written by `write`.

    :raises ValueError: naming file, line and column of the error.
    :raises OSError: when there is no such file.
    """
    try:
        text = input_file.read_bytes(path, LARGEST).decode()
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f'{path}: damaged: {error}') from error
    names = lines[0] if lines else []
    missing = [column.name for column in COLUMNS if column.name not in (*names, *_LATER)]
    if missing:
        raise ValueError(f'{path}: line 1: no column {missing[0]!r}, expected a table of episodes')
    if len(lines) < 2:
        raise ValueError(f'{path}: no episodes, expected one a line from line 2 on')
    for number, line in enumerate(lines[1:], 2):
        if len(line) != len(names):
            raise ValueError(
                f'{path}: line {number}: got {len(line)} columns, expected {len(names)}')
    columns = dict(zip(names, zip(*lines[1:], strict=True), strict=True))
    wordy = {column.name for column in COLUMNS if column.words}
    return EpisodeTable(
        numbers={
            **{name: np.full(len(lines) - 1, np.nan) for name in _LATER},
            **{name: _numbers(path, name, cells)
               for name, cells in columns.items() if name not in wordy}},
        words={name: columns[name] for name in wordy})


def _numbers(path: Path, name: str, cells: Sequence[str]) -> F64:
    """Return the numbers of a column, `(K,)`."""
    values = np.empty(len(cells))
    for place, cell in enumerate(cells):
        try:
            values[place] = float(cell) if cell else np.nan
        except ValueError:
            raise ValueError(
                f'{path}: line {place + 2}: column {name!r}: got {cell!r}, expected a number'
            ) from None
    return values
