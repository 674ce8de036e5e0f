# SPDX-License-Identifier: Apache-2.0
"""The plot of `bench result`: mean return of deterministic evaluations over wall-clock time."""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.time_to_result.result_records import TimedRun
from ppo_agent_node.reporting.pictures import style


def draw(
    runs: Sequence[TimedRun], names: Mapping[str, str], target: float, path: Path, title: str,
) -> Path:
    """Draw one line per run, coloured by contestant, with a star where it passed.

    :param names: names of the contestants, for the legend.
    :param target: required mean return; 0: not drawn.
    """
    with style.styled():
        figure = Figure(figsize=(9, 5))
        axes = figure.add_subplot()
        colours = dict(zip(
            dict.fromkeys(run.contestant for run in runs), style.CYCLE, strict=False))
        labelled = set()
        for run in runs:
            colour = colours[run.contestant]
            label = '' if run.contestant in labelled else names[run.contestant]
            labelled.add(run.contestant)
            x = [point.seconds for point in run.evaluations]
            y = [point.mean_return for point in run.evaluations]
            axes.plot(x, y, color=colour, alpha=0.7, lw=1.3, marker='.', ms=4, label=label)
            if run.passed:
                axes.plot(x[-1], y[-1], color=colour, marker='*', ms=13, ls='')
        if target:
            axes.axhline(target, color=style.INK, lw=1, ls=':')
        if len(colours) > 1:
            axes.set_xscale('log')
            style.plain_logarithm(axes.xaxis)
        axes.set_xlabel('s from the start of the processes')
        axes.set_ylabel('mean return of a deterministic evaluation')
        axes.set_title(title)
        axes.legend()
        return style.save(figure, path)
