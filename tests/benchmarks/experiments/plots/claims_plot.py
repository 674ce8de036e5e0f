# SPDX-License-Identifier: Apache-2.0
"""The plot of `experiments claims`: one panel per claim, one dot per seed."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.experiments import claims
from benchmarks.experiments import statistics
from ppo_agent_node.reporting.pictures import style

_COLOURS = dict(zip(claims.CLONED, (style.BLUE, style.VERMILION), strict=True))


def title(figures: Mapping[str, Any]) -> str:
    """Return a one-line summary of the results."""
    texts = []
    for claim in ('direct PPO fails', 'cloning first lands', 'PPO then softens'):
        said = [verdict.partition(':')[0] for name, _, verdict in claims.verdicts(figures)
                if name == claim]
        texts.append(f'{claim}: {said[0] if len(set(said)) == 1 else "it depends"}')
    text = '; '.join(texts)
    return text[0].upper() + text[1:]


def draw(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw the plot."""
    with style.styled():
        figure = Figure(figsize=(12, 5))
        landed, soft, wide = figure.subplots(1, 3, width_ratios=(1.2, 0.8, 1.2))
        _landed(landed, figures)
        _softened(soft, figures)
        _wider(wide, figures)
        figure.legend(
            *soft.get_legend_handles_labels(), loc='outside lower right', ncols=len(_COLOURS))
        figure.suptitle(title(figures), x=0.01, ha='left')
        return style.save(figure, path)


def _landed(axes: Axes, figures: Mapping[str, Any]) -> None:
    """Draw the landing rate of each training method."""
    ways = [(way, 'last', None, way) for way in claims.DIRECT] + [
        (way, stage, claims.TRAINED, f'{name}: {way}') for way in claims.CLONED
        for stage, name in (('cloned', 'clone'), ('last', 'clone, then PPO'))]
    for place, (way, stage, task, _) in enumerate(ways):
        flown = claims.chosen(figures, way, stage, task)
        rate = statistics.landed(flown)
        axes.plot([rate.low, rate.high], [place, place], color=style.BLUE, lw=5, alpha=0.3)
        axes.plot([100 * one['landing_rate'] for one in flown], [place] * len(flown),
                  color=style.BLUE, marker='o', ms=5, ls='')
    axes.set_yticks(range(len(ways)), [label for *_, label in ways])
    axes.invert_yaxis()
    axes.set_xlim(-3, 103)
    axes.set_xlabel('landed (%) on the level trained for')
    axes.set_title('Who lands')


def _softened(axes: Axes, figures: Mapping[str, Any]) -> None:
    """Draw touchdown speeds before and after PPO, one line per seed."""
    for way, colour in _COLOURS.items():
        before, after = ([claims.speed(one) for one in claims.chosen(
            figures, way, stage, claims.TRAINED)] for stage in ('cloned', 'last'))
        for pair in zip(before, after, strict=True):
            if None not in pair:
                axes.plot([0, 1], pair, color=colour, marker='o', ms=5)
        axes.plot([], [], color=colour, marker='o', ms=5, label=f'PPO, settings: {way}')
    axes.set_xticks([0, 1], ['clone', 'after PPO'])
    axes.set_xlim(-0.2, 1.2)
    axes.set_ylim(bottom=0)
    axes.set_ylabel('mean touchdown speed (m/s), level 7')
    axes.set_title('Does PPO soften?')


def _wider(axes: Axes, figures: Mapping[str, Any]) -> None:
    """Draw the change of return by PPO in tasks that were not trained."""
    for offset, (way, colour) in zip((-0.15, 0.15), _COLOURS.items(), strict=True):
        for place, task in enumerate(claims.WIDER):
            pairs = zip(*(claims.chosen(figures, way, stage, task)
                          for stage in ('cloned', 'last')), strict=True)
            change = [after['mean_return'] - before['mean_return'] for before, after in pairs]
            axes.plot(change, [place + offset] * len(change), color=colour, marker='o', ms=5,
                      ls='', alpha=0.8)
    axes.axvline(0, color=style.INK, lw=1)
    axes.set_yticks(range(len(claims.WIDER)), [style.plain(str(task)) for task in claims.WIDER])
    axes.invert_yaxis()
    axes.set_xlabel('change of the mean return by PPO')
    axes.set_title('Does PPO generalise?')
