# SPDX-License-Identifier: Apache-2.0
"""The plots of `bench examples`: learning curves over environment steps."""
from __future__ import annotations

import statistics
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ppo_agent_node.reporting.pictures import style

FULL_REACH = 194.8
"""m, from the spawn height down to touchdown"""


def title(world: str, runs: Sequence[Mapping[str, Any]], names: Mapping[str, str]) -> str:
    """Return the finding: the example that needs the fewest steps, or that gets the highest."""
    lander = world == 'lunar_lander'
    ends: dict[str, list[float]] = {}
    for run in runs:
        last = run['curve'][-1]
        ends.setdefault(run['example'], []).append(last['steps'] if lander else _reach(last))
    medians = {example: statistics.median(values) for example, values in ends.items()}
    if lander:
        best = min(medians, key=medians.__getitem__)
        passed = sum(bool(run['passed']) for run in runs)
        return (f'{passed} of {len(runs)} runs reach 200; {names[best]} needs the fewest steps, '
                f'{medians[best]:,.0f}')
    best = max(medians, key=medians.__getitem__)
    return (f'Rocket: {names[best]} lands from the highest starts, '
            f'{medians[best]:.0f} of {FULL_REACH:.0f} m')


def _reach(point: Mapping[str, Any]) -> float:
    """Return the height of the highest starts, m; after the curriculum it is not recorded."""
    return float(point['reach'] or FULL_REACH)


def draw(
    world: str, runs: Sequence[Mapping[str, Any]], names: Mapping[str, str], target: float,
    path: Path,
) -> Path:
    """Draw returns, or the reach of the curriculum: one line per run, coloured by example."""
    rockets = world != 'lunar_lander'
    with style.styled():
        figure = Figure(figsize=(9, 5))
        axes = figure.add_subplot()
        colours = dict(zip(names, style.CYCLE, strict=False))
        labelled = set()
        for run in runs:
            example = run['example']
            x = [point['steps'] for point in run['curve']]
            y = [_reach(point) if rockets else point['mean_return']
                 for point in run['curve']]
            axes.plot(
                x, y, color=colours[example], alpha=0.75, lw=1.3,
                label='' if example in labelled else names[example])
            labelled.add(example)
            if run['passed']:
                axes.plot(x[-1], y[-1], color=colours[example], marker='*', ms=11, ls='')
        if rockets:
            axes.axhline(FULL_REACH, color=style.INK, lw=1, ls=':')
            axes.set(yscale='log', ylabel='m above touchdown, highest starts')
            style.plain_logarithm(axes.yaxis)
        else:
            axes.axhline(target, color=style.INK, lw=1, ls=':')
            axes.set(ylabel='mean return of the last 100 episodes')
        axes.set(xscale='log', xlabel='environment steps', title=title(world, runs, names))
        axes.legend()
        return style.save(figure, path)
