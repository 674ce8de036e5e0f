# SPDX-License-Identifier: Apache-2.0
"""Files of the table of conditions: `conditions.json`, and readable `.md` and `.csv`."""
from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import input_file

LARGEST = 100_000_000
"""Maximum bytes of a table."""
NAME = 'conditions.json'
_PAIRS = ('landing_rate_interval', 'mean_return_interval')
_NUMBERS = ('landing_rate', 'mean_return')
_COLUMNS = (
    'level', 'condition', 'pilot', 'episodes', 'landed', 'landing_rate', 'landing_rate_low',
    'landing_rate_high', 'mean_return', 'mean_return_low', 'mean_return_high',
    'mean_return_landed', 'return_p05', 'tanks_dry', 'fuel_ratio', 'hover_time_s', 'ignitions',
    'control_effort')

Table = Mapping[str, Any]


def write(folder: Path, table: Table) -> None:
    """Write a table to a folder in all three formats.

    :raises ValueError: for a number that is not finite; nothing is written.
    :raises OSError: naming the path.
    """
    write_json(folder / NAME, table)
    write_atomically(folder / 'conditions.md', markdown(table).encode())
    write_atomically(folder / 'conditions.csv', comma_separated(table).encode())


def cell_of(table: Table, pilot: str, level: int, condition: str) -> Mapping[str, Any]:
    """Return one cell.

    :raises KeyError: when there is none.
    """
    for cell in table['cells']:
        if (cell['pilot'], cell['level'], cell['condition']) == (pilot, level, condition):
            found: Mapping[str, Any] = cell
            return found
    raise KeyError(f'{pilot}, level {level}, {condition}')


def rows(table: Table, level: int) -> list[list[str]]:
    """Return header and rows of a level as text: condition, then four figures for each pilot."""
    head = ['condition']
    for pilot in table['pilots']:
        head += [f'{pilot}: landed, %', '95 %', 'return', 'dry, %']
    found = [head]
    for condition in table['conditions']:
        row = [condition]
        for pilot in table['pilots']:
            cell = cell_of(table, pilot, level, condition)
            low, high = cell['landing_rate_interval']
            row += [
                percent(cell['landing_rate']), f'{percent(low)} to {percent(high)}',
                f'{cell["mean_return"]:.2f}', percent(cell['tanks_dry'])]
        found.append(row)
    return found


def percent(rate: float) -> str:
    """Return a rate in per cent; 100.00 and 0.00 are exact, never rounded."""
    inside = 0 < rate < 1
    return f'{min(max(100 * rate, 0.01), 99.99) if inside else 100 * rate:.2f}'


def markdown(table: Table) -> str:
    """Return the table as aligned Markdown, a section for each level."""
    parts = [facts(table)]
    for level in table['levels']:
        parts += [f'## Level {level}', aligned(rows(table, level))]
    return '\n\n'.join(['# Conditions', *parts]) + '\n'


def facts(table: Table) -> str:
    """Return a sentence on what was flown."""
    return (
        f'World `{table["world"]}`, {table["episodes"]} episodes per cell on '
        f'{table["num_envs"]} rockets, seed {table["seed"]}. Landed: with its 95 % Wilson '
        'interval; return: mean over all episodes; dry: ended with an empty tank.')


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Return header and rows as a Markdown table; all columns but the first are right-aligned."""
    widths = [max(len(line[place]) for line in lines) for place in range(len(lines[0]))]

    def text(line: Sequence[str]) -> str:
        cells = [line[0].ljust(widths[0]), *(
            cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))]
        return f'| {" | ".join(cells)} |'

    rule = [f'{"-" * widths[0]}', *(f'{"-" * (width - 1)}:' for width in widths[1:])]
    return '\n'.join([text(lines[0]), f'| {" | ".join(rule)} |', *map(text, lines[1:])])


def comma_separated(table: Table) -> str:
    """Return the table with a line for each cell; empty for a missing value."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator='\n')
    writer.writerow(_COLUMNS)
    for cell in table['cells']:
        values = {
            **cell, 'landing_rate_low': cell['landing_rate_interval'][0],
            'landing_rate_high': cell['landing_rate_interval'][1],
            'mean_return_low': cell['mean_return_interval'][0],
            'mean_return_high': cell['mean_return_interval'][1],
            'hover_time_s': cell['hover_time']['mean'], 'ignitions': cell['ignitions']['mean'],
            'control_effort': cell['control_effort']['mean']}
        writer.writerow([
            '' if (value := values[name]) is None else
            format(value, '.10g') if isinstance(value, float) else value for name in _COLUMNS])
    return out.getvalue()


def read(path: Path) -> dict[str, Any] | None:
    """Return a table written by `write`, None if there is none.

    :raises ValueError: naming the file and the problem.
    :raises OSError: when it cannot be read.
    """
    if not path.exists():
        return None
    text = input_file.read_text(path, LARGEST)
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f'{path}: damaged: {error}') from error
    if not isinstance(table, dict):
        raise ValueError(f'{path}: damaged, expected an object')
    for name, kind in (('pilots', str), ('conditions', str), ('levels', int), ('cells', dict)):
        values = table.get(name)
        if not isinstance(values, list) or not values or not all(
                isinstance(value, kind) for value in values):
            raise ValueError(f'{path}: {name}: got {values!r:.200}, expected a list')
    for name in ('seed', 'episodes', 'num_envs'):
        if not isinstance(table.get(name), int):
            raise ValueError(f'{path}: {name}: got {table.get(name)!r:.200}, expected a number')
    if not isinstance(table.get('world'), str):
        raise ValueError(f'{path}: world: got {table.get("world")!r:.200}, expected a name')
    for cell in table['cells']:
        _check_cell(path, cell)
    for pilot in table['pilots']:
        for level in table['levels']:
            for condition in table['conditions']:
                try:
                    cell_of(table, pilot, level, condition)
                except KeyError as error:
                    raise ValueError(f'{path}: cells: no cell for {error}') from error
    return table


def _check_cell(path: Path, cell: Mapping[str, Any]) -> None:
    """Check the displayed figures.

    :raises ValueError: naming the file, the cell and the figure.
    """
    where = f'{path}: cells: {cell.get("pilot")!s:.40}, {cell.get("condition")!s:.40}'
    for name in (*_NUMBERS, 'tanks_dry'):
        if not _is_number(cell.get(name)):
            raise ValueError(f'{where}: {name}: got {cell.get(name)!r:.200}, expected a number')
    for name in _PAIRS:
        pair = cell.get(name)
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(_is_number, pair)):
            raise ValueError(f'{where}: {name}: got {pair!r:.200}, expected a pair of numbers')


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and (
        abs(value) <= sys.float_info.max)
