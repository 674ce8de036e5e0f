# SPDX-License-Identifier: Apache-2.0
"""Result tables of a comparison, in Markdown."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from rocket_sim_node.palette import words
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo


class Flown(Protocol):
    """Interface of a pilot's flights that tables need."""

    @property
    def name(self) -> str:
        """The pilot's label in tables."""
        ...

    @property
    def flights(self) -> tuple[Trajectory, ...]:
        """Its flights."""
        ...


def results(
    sides: Sequence[Flown], verdicts: Sequence[Sequence[str]], info: WorldInfo, heading: str = '',
    remarks: Sequence[str] = (),
) -> str:
    """Return two tables: means of each pilot, and the end of each flight.

    :param verdicts: for each start, the verdict on each pilot's vehicle; '' if not determined.
    :param heading: a line above them; `remarks` follow them.
    """
    count = len(sides[0].flights)
    stands = any(verdict for ends in verdicts for verdict in ends)
    parts = [heading, *remarks, _means(sides, verdicts, info, stands=stands)]
    ends = [
        (str(start + 1), *(
            _end(side.flights[start], verdict)
            for side, verdict in zip(sides, verdicts[start], strict=True)))
        for start in range(count)]
    parts.append(_table(('start', *(side.name for side in sides)), ends))
    return '\n\n'.join(part for part in parts if part) + '\n'


def touchdown_speed(flight: Trajectory) -> float:
    """Return the speed at first contact, m/s; at the end if there is none, or it is the end."""
    first = int(np.argmax(flight.touching)) if flight.touching.any() else len(flight)
    return float(flight.speed[max(first - 1, 0)])


def _means(
    sides: Sequence[Flown], verdicts: Sequence[Sequence[str]], info: WorldInfo, *, stands: bool,
) -> str:
    fuel = info.fuel > 0
    rows = []
    for number, side in enumerate(sides):
        flights = side.flights
        landed = [flight for flight in flights if flight.outcome == info.outcomes[0]]
        standing = sum(ends[number] == 'stands' for ends in verdicts)
        rows.append((
            side.name, f'{len(landed)} of {len(flights)}',
            *((f'{standing}',) if stands else ()),
            _mean('.1f', (f.total_return for f in flights)),
            _mean('.3f', map(touchdown_speed, landed)),
            _mean('.2f', (f.tilt[-1] for f in landed)),
            _mean('.2f', (f.distance[-1] for f in landed)),
            *((_mean('.0f', (f.fuel[0] - f.fuel[-1] for f in flights)),) if fuel else ()),
            _mean('.1f', ((len(f) - 1) * info.dt for f in flights))))
    table = _table((
        'mean of', 'landed', *(('stand',) if stands else ()), 'return', 'touchdown m/s',
        'tilt °', 'offset m', *(('fuel kg',) if fuel else ()), 'time s'), rows)
    return f'{table}\n\nTouchdown, tilt and offset: means of those that landed.'


def _end(flight: Trajectory, verdict: str) -> str:
    """Return a table cell with the end of a flight."""
    end = words(flight.outcome or 'unfinished')
    if verdict and verdict != 'stands':
        end = f'{end}, {words(verdict)}'
    return f'{end} {touchdown_speed(flight):.2f} m/s, {flight.total_return:.1f}'


def _mean(digits: str, values: Iterable[float]) -> str:
    """Return a mean as text, a dash if there are no values."""
    known = np.fromiter(values, np.float64)
    return format(float(known.mean()), digits) if known.size else '–'


def _table(names: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; the first column is text, the others are right-aligned."""
    lines = [names, ['---', *['---:'] * (len(names) - 1)], *rows]
    return '\n'.join(f'| {" | ".join(cells)} |' for cells in lines)
