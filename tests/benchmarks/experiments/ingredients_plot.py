# SPDX-License-Identifier: Apache-2.0
"""The picture of `experiments ingredients`: what each variant changes of the return."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.experiments import ingredients
from ppo_agent_node.reporting import style

_LINEAR = 0.1
"""return up to which the axis is linear, logarithmic beyond"""
_COLOURS = {'cloned': style.ORANGE, 'policy': style.BLUE}
_NAMES = {'cloned': 'clone', 'policy': 'policy, after PPO'}


def title(figures: Mapping[str, Any]) -> str:
    """Return what was found, in a line: what harms most, of imitation and of PPO."""
    worth = ingredients.worth(figures, 'policy', ingredients.TASKS[0])
    worst = {}
    for variant in figures['variants']:
        name, stage = variant['name'], variant['stage']
        if stage not in worst or worth[name].value < worth[worst[stage]].value:
            worst[stage] = name
    texts = [f'{name} {worth[name].value:+.3g}' for name in worst.values()]
    return f'What costs most on level 7, imitation and PPO: {", ".join(texts)}'


def draw(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw a panel a level: dots are seeds, bars the 95 % interval of their mean."""
    names = [variant['name'] for variant in figures['variants']]
    with style.styled():
        figure = Figure(figsize=(11, 1.8 + 0.42 * len(names)))
        panels = figure.subplots(1, len(ingredients.TASKS), sharey=True)
        for panel, task in zip(panels, ingredients.TASKS, strict=True):
            for offset, stage in ((0.16, 'policy'), (-0.16, 'cloned')):
                places = np.arange(len(names)) + offset
                for place, name in zip(places, names, strict=True):
                    _mark(panel, place, ingredients.differences(figures, name, stage, task), stage)
            _dress(panel, names, task.level)
        panels[0].set_yticks(range(len(names)), [style.plain(name) for name in names])
        for stage, colour in _COLOURS.items():
            panels[0].plot([], [], color=colour, marker='o', ls='', label=_NAMES[stage])
        figure.legend(loc='outside lower center', ncols=2)
        figure.suptitle(title(figures), x=0.01, ha='left')
        return style.save(figure, path)


def _mark(panel: Axes, place: float, values: list[float], stage: str) -> None:
    """Draw the differences of a variant."""
    colour = _COLOURS[stage]
    if not any(values):
        return  # the base's own: nothing changed
    mean = ingredients.statistics.over_seeds(values)
    if len(values) > 1:
        panel.plot([mean.low, mean.high], [place, place], color=colour, lw=1.4, alpha=0.6)
    panel.plot(values, [place] * len(values), color=colour, marker='o', ms=4, ls='')


def _dress(panel: Axes, names: list[str], level: int) -> None:
    panel.axvline(0, color=style.INK, lw=1)
    panel.set_xscale('symlog', linthresh=_LINEAR)
    panel.set_xlabel('change of the mean return')
    panel.set_title(f'level {level}', fontsize=10.5)
    panel.set_ylim(len(names) - 0.5, -0.5)
