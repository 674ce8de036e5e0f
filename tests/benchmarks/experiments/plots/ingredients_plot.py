# SPDX-License-Identifier: Apache-2.0
"""The plot of `experiments ingredients`: the change of return by each variant."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from benchmarks.experiments import ingredients
from benchmarks.experiments import statistics
from benchmarks.experiments import variants
from benchmarks.experiments.flights import Task
from ppo_agent_node.reporting.pictures import style

_LINEAR = 0.1
"""limit of the linear part of the axis; beyond it, the axis is logarithmic"""
_COLOURS = {'cloned': style.ORANGE, 'last': style.BLUE}
_NAMES = {'cloned': 'clone', 'last': 'after PPO'}


def title(figures: Mapping[str, Any]) -> str:
    """Return in a line the variants of imitation and of PPO that lose the most return."""
    worth = ingredients.worth(figures, 'last', ingredients.TASKS[0])
    texts = []
    for stage in (variants.IMITATION, variants.PPO):
        sure = {one['name']: worth[one['name']].value for one in figures['variants']
                if one['stage'] == stage and worth[one['name']].high < 0}
        worst = min(sure, key=lambda name: sure[name], default=None)
        texts.append(f'{stage}: ' + (
            f'{worst}, {sure[worst]:+.3g}' if worst else 'nothing beyond doubt'))
    return f'Greatest loss of return on level 7, {"; ".join(texts)}'


def draw(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw one panel per level: dots are seeds, bars the 95 % interval of their mean."""
    names = [variant['name'] for variant in figures['variants']]
    with style.styled():
        figure = Figure(figsize=(11, 1.8 + 0.42 * len(names)))
        panels = figure.subplots(1, len(ingredients.TASKS), sharex=True, sharey=True)
        for panel, task in zip(panels, ingredients.TASKS, strict=True):
            for place, variant in enumerate(figures['variants']):
                _row(panel, place, figures, variant, task)
            base = [one['mean_return'] for one in ingredients.chosen(
                figures, variants.BASE.name, 'last', task)]
            _dress(panel, len(names), f'level {task.level}: base {np.mean(base):.1f}')
        panels[0].set_yticks(range(len(names)), [style.plain(name) for name in names])
        for stage, colour in _COLOURS.items():
            panels[0].plot([], [], color=colour, marker='o', ls='', label=_NAMES[stage])
        figure.legend(loc='outside lower center', ncols=2)
        figure.suptitle(title(figures), x=0.01, ha='left')
        return style.save(figure, path)


def _row(
    panel: Axes, place: int, figures: Mapping[str, Any], variant: Mapping[str, Any], task: Task,
) -> None:
    """Draw the differences of a variant; variants of PPO have the base's clone, left out here."""
    for offset, stage in ((0.16, 'last'), (-0.16, 'cloned')):
        if (stage, variant['stage']) == ('cloned', variants.PPO):
            continue
        values = ingredients.differences(figures, variant['name'], stage, task)
        mean = statistics.over_seeds(values)
        if len(values) > 1:
            panel.plot([mean.low, mean.high], [place + offset] * 2, color=_COLOURS[stage], lw=1.4,
                       alpha=0.6)
        panel.plot(values, [place + offset] * len(values), color=_COLOURS[stage], marker='o',
                   ms=4, ls='')


def _dress(panel: Axes, count: int, title: str) -> None:
    panel.axvline(0, color=style.INK, lw=1)
    panel.set_xscale('symlog', linthresh=_LINEAR)
    panel.set_xticks([-100, -10, -1, 0, 1, 10, 100])
    panel.xaxis.set_major_formatter(StrMethodFormatter('{x:+,.10g}'))
    panel.set_xlabel('change of the mean return (reward points)')
    panel.set_title(title, fontsize=10.5)
    panel.set_ylim(count - 0.5, -0.5)
