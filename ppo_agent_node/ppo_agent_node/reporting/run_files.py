# SPDX-License-Identifier: Apache-2.0
"""Reader of the files in the folder of a run or an evaluation."""
from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from ppo_agent_node.evaluation import conditions_files
from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.runs.config_file import read_config
from ppo_agent_node.runs.train_log import read_log
from rocket_sim_node import input_file
from rocket_sim_node.worlds.base import F64

CONFIG, LOG, FIGURES, EPISODES = 'config.yaml', 'train.jsonl', 'evaluation.json', 'episodes.csv'
CONDITIONS = conditions_files.NAME
LARGEST = 100_000_000
"""Maximum bytes of an evaluation's figures."""
Lines = Sequence[Mapping[str, Any]]

_PAIR = 'a pair of numbers'
_SPREAD = "'mean' and 'p95'"
_EXPECTED: dict[str, str] = {
    'world': 'a string', 'episodes': 'a whole number', 'landed': 'a whole number',
    'landing_rate': 'a number', 'landing_rate_interval': _PAIR, 'mean_return': 'a number',
    'mean_return_interval': _PAIR, 'outcomes': 'names and whole numbers'}
_OPTIONAL: dict[str, str] = {
    'touchdown_speed': _SPREAD, 'tilt': _SPREAD, 'distance': _SPREAD, 'fuel_used_kg': _SPREAD,
    'fuel_optimum_kg': 'a number', 'fuel_ratio_optimum': 'a number', 'time_optimum_s': 'a number',
    'return_ceiling': 'a number', 'optimum_sample': 'a whole number', 'optimum_reason': 'a string',
    'fuel_ratio': 'a number', 'fuel_bound_kg': 'a number', 'mean_length': 'a number',
    'return_std': 'a number', 'standing_rate': 'a number', 'standing_rate_interval': _PAIR,
    'settling': 'names and whole numbers', 'world_settings': 'names and values',
    'conditions': 'a string', 'return_p05': 'a number', 'mean_return_landed': 'a number',
    'mean_return_standing': 'a number', 'tanks_dry': 'a number', 'tanks_dry_interval': _PAIR,
    'mean_return_tanks_dry': 'a number', 'hover_time': _SPREAD, 'ignitions': _SPREAD,
    'control_effort': _SPREAD}
"""Entries that may be missing or null."""


@dataclass(frozen=True)
class Run:
    """Files of a run; missing ones are None or empty."""

    path: Path
    config: dict[str, Any]
    lines: list[dict[str, Any]]
    figures: dict[str, Any] | None
    episodes: EpisodeTable | None
    conditions: dict[str, Any] | None = None
    """The table of conditions, see `evaluation.conditions_table`."""

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.path.resolve().name

    @property
    def world(self) -> str:
        """Name of the world, '' if no file has it."""
        return str(self.config.get('world') or (self.figures or {}).get('world')
                   or (self.conditions or {}).get('world') or '')

    @property
    def world_settings(self) -> dict[str, Any]:
        """Settings of the world: as evaluated, else as trained, else none."""
        flown = (self.figures or {}).get('world_settings') or self.config.get('world_settings')
        return dict(flown) if isinstance(flown, dict) else {}

    @property
    def training(self) -> dict[str, Any]:
        """Settings of the training by name, `{}` for an evaluation alone."""
        return dict(self.config.get('training') or {})

    @property
    def seconds(self) -> float | None:
        """Wall clock of everything in the log, s; None for an evaluation alone."""
        return float(np.nansum(column(self.lines, 'seconds'))) if self.lines else None

    @property
    def date(self) -> datetime:
        """Modification time of its newest file."""
        times = [path.stat().st_mtime for name in (CONFIG, LOG, FIGURES, CONDITIONS)
                 if (path := self.path / name).exists()]
        return datetime.fromtimestamp(max(times)).astimezone()

    def stage(self, name: str) -> Lines:
        """Return the log's lines of a stage."""
        return [line for line in self.lines if line['stage'] == name]


def load(path: Path) -> Run:
    """Read a folder.

    :raises ValueError: when it contains no run, or a file is damaged; the message names it.
    :raises OSError: when a file cannot be read.
    """
    if not path.is_dir():
        raise ValueError(f'{path}: no such folder, expected that of a run or an evaluation')
    if not any((path / name).exists() for name in (CONFIG, LOG, FIGURES, CONDITIONS)):
        raise ValueError(
            f'{path}: no run, expected a folder with {CONFIG} and {LOG}, or with {FIGURES} or '
            f'{CONDITIONS}')
    figures = _figures(path / FIGURES)
    episodes = path / EPISODES
    return Run(
        path, _config(path / CONFIG), _lines(path / LOG), figures,
        episode_table.read(episodes) if figures and episodes.exists() else None,
        conditions_files.read(path / CONDITIONS))


def column(lines: Lines, name: str) -> F64:
    """Return an entry of all lines `(K,)`, NaN if missing.

    :raises ValueError: when one is not a number.
    """
    values = [line.get(name) for line in lines]
    for value in values:
        if value is not None and not (isinstance(value, int | float) and _fits(value)):
            raise ValueError(f'{LOG}: {name}: got {value!r:.200}, expected a number')
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _lines(path: Path) -> list[dict[str, Any]]:
    """Return the log, `[]` if there is none."""
    lines = read_log(path)
    for number, line in enumerate(lines, 1):
        if not isinstance(line.get('stage'), str):
            raise ValueError(f"{path}: line {number} is damaged: expected a 'stage'")
    return lines


def _config(path: Path) -> dict[str, Any]:
    """Return the settings, `{}` if there are none."""
    values = read_config(path)
    for name in ('training', 'world_settings'):
        if not isinstance(values.get(name) or {}, dict):
            raise ValueError(f'{path}: {name}: got {values[name]!r}, expected names and values')
    return values


def _figures(path: Path) -> dict[str, Any] | None:
    """Return the figures of the evaluation, None if there is none."""
    if not path.exists():
        return None
    text = input_file.read_text(path, LARGEST)
    try:
        figures = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f'{path}: damaged: {error}') from error
    if not isinstance(figures, dict):
        raise ValueError(f'{path}: damaged, expected an object')
    for name, expected in _EXPECTED.items():
        if not _is(figures.get(name), expected):
            raise ValueError(
                f'{path}: {name}: got {figures.get(name)!r:.200}, expected {expected}')
    for name, expected in _OPTIONAL.items():
        if figures.get(name) is not None and not _is(figures[name], expected):
            raise ValueError(f'{path}: {name}: got {figures[name]!r:.200}, expected {expected}')
    return figures


def _is(value: Any, expected: str) -> bool:
    """Return whether a value has the type that `expected` describes."""
    if expected == _PAIR:
        return isinstance(value, list) and len(value) == 2 and all(
            _is(one, 'a number') for one in value)
    if expected == _SPREAD:
        return isinstance(value, dict) and all(
            value.get(name) is None or _is(value[name], 'a number') for name in ('mean', 'p95'))
    if expected.startswith('names'):
        return isinstance(value, dict) and (expected == 'names and values' or all(
            _is(one, 'a whole number') for one in value.values()))
    kinds: dict[str, Any] = {
        'a string': str, 'a whole number': int, 'a number': int | float}
    return isinstance(value, kinds[expected]) and not isinstance(value, bool) and (
        expected == 'a string' or _fits(value))


def _fits(value: float) -> bool:
    """Return whether a number is finite and fits into a float; false for NaN."""
    return abs(value) <= sys.float_info.max
