# SPDX-License-Identifier: Apache-2.0
"""Pictures of the outcomes and returns of an evaluation's episodes."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.style import GREEN
from ppo_agent_node.reporting.pictures.style import GREY
from ppo_agent_node.reporting.pictures.style import INK
from rocket_sim_node.palette import words

SOLVED = {'lunar_lander': 200.0}
"""Returns that count as solved, by world (Gymnasium's documentation of LunarLander)."""
_LABELLED = 4.0
"""Minimum % of a slice for a label in the pie; the bars label all of them."""


def subject(figures: Mapping[str, Any]) -> str:
    """Return pilot and world, for titles."""
    level = figures.get('level')
    where = figures['world'] if level is None else f'{figures["world"]}, level {level}'
    file = figures.get('policy_file')
    who = Path(str(file)).name if file else figures.get('policy', 'policy')
    return style.plain(f'{who} on {where}')


def outcomes_figure(figures: Mapping[str, Any]) -> Figure:
    """Return the outcomes: a pie, and bars with all counts."""
    figure = Figure(figsize=(9.5, 4.2))
    pie, bars = figure.subplots(1, 2, width_ratios=(2, 3))
    counts: dict[str, int] = figures['outcomes']
    total = max(1, sum(counts.values()))
    colours = style.outcome_colours(tuple(counts))
    _pie(pie, counts, total, colours)
    names = list(counts)
    share = [100 * count / total for count in counts.values()]
    bars.barh(names, share, color=[colours[name] for name in names], height=0.7)
    for place, (count, percent) in enumerate(zip(counts.values(), share, strict=True)):
        inside = percent > 60
        bars.annotate(
            f'{count} ({percent:.2f} %)' if count else '0', (percent, place),
            (-6 if inside else 6, 0), textcoords='offset points', va='center',
            ha='right' if inside else 'left', color='white' if inside else INK)
    bars.set_yticks(range(len(names)), [style.plain(words(name)) for name in names])
    bars.invert_yaxis()
    bars.set_xlim(0, 100)
    bars.grid(visible=False, axis='y')
    bars.set_xlabel('share of episodes (%)')
    low, high = (100 * bound for bound in figures['landing_rate_interval'])
    figure.suptitle(
        f'{subject(figures)}: {figures["landed"]} of {figures["episodes"]} landed, '
        f'{100 * figures["landing_rate"]:.2f} % (95 % interval {low:.2f} to {high:.2f} %)',
        x=0.01, ha='left')
    return figure


def _pie(axes: Axes, counts: Mapping[str, int], total: int, colours: Mapping[str, str]) -> None:
    """Draw the slices clockwise from the top; thin ones are labelled in the bars only."""
    there = {name: count for name, count in counts.items() if count}
    labels = [
        f'{words(name)}\n{100 * count / total:.3g} %'
        if _LABELLED <= 100 * count / total < 100 else '' for name, count in there.items()]
    axes.pie(
        list(there.values()), labels=[style.plain(label) for label in labels],
        colors=[colours[name] for name in there], startangle=90, counterclock=False,
        labeldistance=1.12, wedgeprops={'edgecolor': 'white', 'linewidth': 1 if there else 0})
    if len(there) == 1:
        axes.text(0, 0, f'{words(*there)}\n100 %', ha='center', va='center', color='white',
                  fontsize=14, fontweight='bold')


def returns_figure(figures: Mapping[str, Any], episodes: EpisodeTable) -> Figure:
    """Return the return of each episode, in order of flight, and the distribution."""
    figure = Figure(figsize=(9.5, 4.6))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(4, 1))
    returns = episodes.numbers['return']
    number = np.arange(1, len(returns) + 1)
    dots(left, number, returns, episodes, figures['outcomes'], np.ones(len(returns), np.bool_))
    left.axhline(returns.mean(), color=INK, lw=1.2, ls='--')
    solved = SOLVED.get(figures['world'])
    if solved is not None:
        left.axhline(solved, color=GREEN, lw=1.2, label=f'solved, {solved:g} or more')
        right.axhline(solved, color=GREEN, lw=1.2)
    left.set_xlim(0, len(returns) + 1)
    style.whole_ticks(left)
    left.set_xlabel('episode')
    left.set_ylabel('return (reward points)')
    low, high = figures['mean_return_interval']
    left.set_title(f'{subject(figures)}: mean return {returns.mean():.2f} '
                   f'(95 % interval {low:.2f} to {high:.2f})')
    right.hist(returns, bins=40, orientation='horizontal', color=GREY)
    right.axhline(returns.mean(), color=INK, lw=1.2, ls='--', label='mean')
    right.set_xlabel('episodes per bin')
    handles, labels = left.get_legend_handles_labels()
    more, names = right.get_legend_handles_labels()
    figure.legend(handles + more, labels + names, loc='outside lower center', markerscale=2.5,
                  ncols=min(6, len(handles) + 1))
    return figure


def dots(
    axes: Axes, x: style.Values, y: style.Values, episodes: EpisodeTable,
    outcomes: Mapping[str, int], chosen: style.Chosen, size: float = 4.0,
) -> None:
    """Draw a dot for each selected episode, coloured by outcome, with landed ones behind.

    :param x: `(K,)`, like `y` and `chosen`.
    """
    colours = style.outcome_colours(tuple(outcomes))
    for name in outcomes:
        places = style.thin(chosen & episodes.named(name))
        if len(places):
            axes.plot(x[places], y[places], '.', ms=size, alpha=0.6, mew=0,
                      color=colours[name], label=style.plain(words(name)))
