# SPDX-License-Identifier: Apache-2.0
"""The results of a comparison as tables, in Markdown."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from rocket_sim_node.recording.flight import Flight
from rocket_sim_node.recording.flight_log import words
from rocket_sim_node.recording.stage import Stage


class Flown(Protocol):
    """What one pilot flew, as far as tables know it."""

    @property
    def name(self) -> str:
        """What tables call the pilot."""
        ...

    @property
    def flights(self) -> tuple[Flight, ...]:
        """Its flights."""
        ...


def results(
    sides: Sequence[Flown], verdicts: Sequence[Sequence[str]], stage: Stage, heading: str = '',
    remarks: Sequence[str] = (),
) -> str:
    """Return two tables: means of each pilot, and how each flight of each ended.

    :param verdicts: for each start, what became of each pilot's vehicle; '' where nobody asked.
    :param heading: a line above them; `remarks` follow it.
    """
    count = len(sides[0].flights)
    stands = any(verdict for ends in verdicts for verdict in ends)
    parts = [heading, *remarks, _means(sides, verdicts, stage, stands=stands)]
    ends = [
        (str(start + 1), *(
            _end(side.flights[start], verdict)
            for side, verdict in zip(sides, verdicts[start], strict=True)))
        for start in range(count)]
    parts.append(_table(('start', *(side.name for side in sides)), ends))
    return '\n\n'.join(part for part in parts if part) + '\n'


def touchdown_speed(flight: Flight) -> float:
    """Return the speed when the ground was met, m/s; at the end where it was not, or ends all."""
    touching = np.any(flight.contact_force != 0.0, axis=1) | np.any(flight.contact > 0.0, axis=1)
    first = int(np.argmax(touching)) if touching.any() else len(flight)
    return float(flight.speed[max(first - 1, 0)])


def _means(
    sides: Sequence[Flown], verdicts: Sequence[Sequence[str]], stage: Stage, *, stands: bool,
) -> str:
    fuel = stage.fuel > 0
    rows = []
    for number, side in enumerate(sides):
        flights = side.flights
        landed = sum(flight.outcome == stage.outcomes[0] for flight in flights)
        standing = sum(ends[number] == 'stands' for ends in verdicts)
        rows.append((
            side.name, f'{landed} of {len(flights)}',
            *((f'{standing}',) if stands else ()),
            f'{_mean(f.total_return for f in flights):.1f}',
            f'{_mean(map(touchdown_speed, flights)):.3f}',
            f'{_mean(f.tilt[-1] for f in flights):.2f}',
            f'{_mean(f.distance[-1] for f in flights):.2f}',
            *((f'{_mean(f.fuel[0] - f.fuel[-1] for f in flights):.0f}',) if fuel else ()),
            f'{_mean((len(f) - 1) * stage.dt for f in flights):.1f}'))
    return _table((
        'mean of', 'landed', *(('stand',) if stands else ()), 'return', 'touchdown m/s',
        'tilt °', 'offset m', *(('fuel kg',) if fuel else ()), 'time s'), rows)


def _end(flight: Flight, verdict: str) -> str:
    """Return how a flight ended, in a cell."""
    end = words(flight.outcome or 'unfinished')
    if verdict and verdict != 'stands':
        end = f'{end}, {words(verdict)}'
    return f'{end} {touchdown_speed(flight):.2f} m/s, {flight.total_return:.1f}'


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(np.fromiter(values, np.float64)))


def _table(names: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; the first column is text, numbers stand to the right."""
    lines = [names, ['---', *['---:'] * (len(names) - 1)], *rows]
    return '\n'.join(f'| {" | ".join(cells)} |' for cells in lines)
