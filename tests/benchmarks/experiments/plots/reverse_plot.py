# SPDX-License-Identifier: Apache-2.0
"""The plot of `experiments reverse`: reach and return by iteration, one line per seed."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments.reverse import FULL_REACH
from ppo_agent_node.reporting.pictures import style


def title(figures: Mapping[str, Any]) -> str:
    """Return a one-line summary of the results."""
    reached = [one['iteration'] for one in figures['seeds'] if one['iteration'] is not None]
    total = len(figures['seeds'])
    if not reached:
        return f'In none of {total} runs did the reverse curriculum reach the full height'
    worst, best = min(reached), max(reached)
    when = f'{worst}' if worst == best else f'{worst} to {best}'
    return (f'From nothing to the full height in {when} iterations, '
            f'{len(reached)} of {total} seeds')


def draw(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw the plot."""
    with style.styled():
        figure = Figure(figsize=(9, 6.5))
        reach, returns = figure.subplots(2, 1, sharex=True)
        for one, colour in zip(figures['seeds'], style.CYCLE, strict=False):
            curves = {name: np.array([np.nan if value is None else value for value in values])
                      for name, values in one['curves'].items()}
            reach.step(curves['iteration'], curves['reach'], where='post', color=colour, lw=1.8,
                       label=f'seed {one["seed"]}')
            flown = np.isfinite(curves['selection_return'])
            returns.plot(
                curves['iteration'][flown], curves['selection_return'][flown], color=colour,
                marker='o', ms=4, lw=1.2)
        reach.axhline(FULL_REACH, color=style.INK, lw=1, ls=':')
        reach.set_yscale('log')
        style.plain_logarithm(reach.yaxis)
        reach.set_ylabel('highest starts, H (m above touchdown)')
        reach.legend(loc='lower right')
        returns.set_ylabel('mean return of level 7,\nwithout noise (reward points)')
        returns.set_xlabel('iteration')
        style.whole_ticks(returns)
        figure.suptitle(title(figures), x=0.01, ha='left')
        return style.save(figure, path)
