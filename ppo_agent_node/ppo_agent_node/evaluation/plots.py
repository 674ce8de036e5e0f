# SPDX-License-Identifier: Apache-2.0
"""An evaluation in pictures."""
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ppo_agent_node.evaluation.intervals import wilson
from ppo_agent_node.evaluation.metrics import touchdowns
from ppo_agent_node.evaluation.runner import EvaluationResult

# Okabe and Ito, 'Color universal design', 2008: told apart by colour-blind readers too.
BLUE, ORANGE, GREEN, VERMILION, SKY, PURPLE, YELLOW, INK = (
    '#0072B2', '#E69F00', '#009E73', '#D55E00', '#56B4E9', '#CC79A7', '#F0E442', '#333333')
_CRASH_COLOURS = (VERMILION, ORANGE, PURPLE, SKY, BLUE, YELLOW)
_GREY = '#BBBBBB'
_SOLVED = {'lunar_lander': 200.0}
"""Returns that count as a solution, by world (Gymnasium's documentation of LunarLander)."""

_STYLE: dict[Any, Any] = {
    'font.size': 10.5, 'axes.titlesize': 12, 'axes.titlelocation': 'left',
    'axes.titleweight': 'bold', 'axes.spines.top': False, 'axes.spines.right': False,
    'axes.edgecolor': INK, 'axes.labelcolor': INK, 'text.color': INK, 'xtick.color': INK,
    'ytick.color': INK, 'axes.grid': True, 'grid.color': '#E6E6E6', 'axes.axisbelow': True,
    'legend.frameon': False, 'savefig.dpi': 150, 'axes.titlepad': 12,
}


def evaluation_plots(result: EvaluationResult, folder: Path) -> list[Path]:
    """Draw what an evaluation has to show, as PNG files, and return their paths.

    `outcomes` and `returns` always; `touchdown` where a rocket touched the ground; `footprint`
    and `fuel` in the rocket worlds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ground = bool(touchdowns(result).any())
    drawings: dict[str, tuple[Callable[[Figure, EvaluationResult], None], float, float]] = {
        'outcomes': (_outcomes, 7.0, 3.6), 'returns': (_returns, 9.0, 4.2)}
    if ground:
        drawings['touchdown'] = _touchdown, 11.0, 4.2
    if ground and result.is_rocket:
        drawings['footprint'] = _footprint, 10.5, 5.2
    if result.is_rocket:
        drawings['fuel'] = _fuel, 7.5, 5.0
    paths = []
    for name, (draw, width, height) in drawings.items():
        with mpl.rc_context(_STYLE):
            figure = Figure(figsize=(width, height), layout='constrained')
            FigureCanvasAgg(figure)
            draw(figure, result)
            paths.append(folder / f'{name}.png')
            figure.savefig(paths[-1])
    return paths


def _subject(result: EvaluationResult) -> str:
    level = result.settings.get('level')
    where = result.spec.name if level is None else f'{result.spec.name}, level {level:g}'
    return f'{result.pilot} on {where}'


def _colours(result: EvaluationResult) -> dict[str, str]:
    """Return a colour for each outcome: green is landed, the rest by their order."""
    crashes = [name for name in result.spec.outcomes if name != 'landed']
    return {'landed': GREEN, **{
        name: _CRASH_COLOURS[k % len(_CRASH_COLOURS)] for k, name in enumerate(crashes)}}


def _outcomes(figure: Figure, result: EvaluationResult) -> None:
    """How the episodes ended."""
    axes, colours = figure.subplots(), _colours(result)
    names = result.spec.outcomes
    total = len(result.episodes)
    counts = [int(result.named(name).sum()) for name in names]
    share = [100 * count / total for count in counts]
    axes.barh(names, share, color=[colours[name] for name in names], height=0.7)
    for place, (count, percent) in enumerate(zip(counts, share, strict=True)):
        text = f'{count} ({percent:.2f} %)' if count else '0'
        inside = percent > 75
        axes.annotate(
            text, (percent, place), (-6 if inside else 6, 0), textcoords='offset points',
            va='center', ha='right' if inside else 'left', color='white' if inside else INK)
    axes.set_yticks(range(len(names)), [name.replace('_', ' ') for name in names])
    axes.invert_yaxis()
    axes.set_xlim(0, 100)
    axes.grid(visible=False, axis='y')
    axes.set_xlabel('share of episodes (%)')
    low, high = wilson(int(result.landed.sum()), total)
    axes.set_title(
        f'{_subject(result)}: {100 * result.landed.mean():.2f} % of {total} landed\n'
        f'95 % interval {100 * low:.2f} to {100 * high:.2f} %', fontsize=11)


def _returns(figure: Figure, result: EvaluationResult) -> None:
    """Return of each episode, in order of flight, and how they are distributed."""
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(4, 1))
    returns, colours = result.episodes.episode_return, _colours(result)
    number = np.arange(1, len(returns) + 1)
    for name in result.spec.outcomes:
        chosen = result.named(name)
        if chosen.any():
            left.plot(
                number[chosen], returns[chosen], '.', ms=4, alpha=0.6, mew=0,
                color=colours[name], label=name.replace('_', ' '))
    left.axhline(returns.mean(), color=INK, lw=1, ls='--')
    solved = _SOLVED.get(result.spec.name)
    if solved is not None:
        left.axhline(solved, color=GREEN, lw=1, label=f'solved, {solved:g}')
        right.axhline(solved, color=GREEN, lw=1)
    left.set_xlim(0, len(returns) + 1)
    left.set_xlabel('episode')
    left.set_ylabel('return')
    left.set_title(f'{_subject(result)}: mean return {returns.mean():.2f}')
    right.hist(returns, bins=40, orientation='horizontal', color=_GREY)
    right.axhline(returns.mean(), color=INK, lw=1, ls='--', label='mean')
    right.set_xlabel('episodes')
    handles, labels = left.get_legend_handles_labels()
    more, names = right.get_legend_handles_labels()
    figure.legend(handles + more, labels + names, loc='outside lower center', markerscale=3,
                  ncols=len(handles) + 1)


def _histogram(
    axes: Axes, values: NDArray[np.float64], landed: NDArray[np.bool_], limit: float | None,
    what: str, unit: str,
) -> None:
    """Draw landed and crashed touchdowns stacked, the 95th percentile, and the limit if near."""
    percentile = float(np.quantile(values, 0.95))
    top = max(float(values.max()), 1e-9)
    near = limit is not None and limit <= 1.5 * top
    parts = [(part, colour) for part, colour in (
        (values[landed], GREEN), (values[~landed], VERMILION)) if part.size]
    edges = np.linspace(0, top, 41)
    axes.hist([part for part, _ in parts], bins=list(edges), stacked=True,
              color=[colour for _, colour in parts])
    if np.histogram(values, edges)[0].max() > 0.5 * values.size:
        axes.set_yscale('log')  # else one bin dwarfs the tail, and the tail is what crashes
        axes.set_ylim(0.7, None)
    axes.axvline(percentile, color=INK, lw=1.2, ls='--')
    if near:
        axes.axvline(limit or 0.0, color=INK, lw=1.2)
    axes.set_xlim(0, None)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(f'{what} ({unit})')
    bound = '' if limit is None else f'; limit {limit:g}' + (' (solid)' if near else '')
    axes.set_title(f'mean {values.mean():.3g} {unit}\n95 % below {percentile:.3g} (dashed){bound}',
                   fontsize=10, fontweight='normal')


def _touchdown(figure: Figure, result: EvaluationResult) -> None:
    """Speed, tilt and distance at the end of flights that ended on the ground.

    For a rocket that is the touchdown; other worlds go on until all is at rest.
    """
    ground, settings = touchdowns(result), result.settings
    when = 'touchdown' if result.is_rocket else 'the end'
    flown, landed = result.episodes, result.landed[ground]
    panels = figure.subplots(1, 3)
    _histogram(panels[0], flown.touchdown_speed[ground], landed, settings.get('landed_speed'),
               f'speed at {when}', 'm/s')
    _histogram(panels[1], flown.tilt[ground], landed, settings.get('landed_tilt'),
               f'tilt at {when}', 'deg')
    _histogram(panels[2], flown.distance[ground], landed, settings.get('landed_distance'),
               "distance from the pad's centre", 'm')
    panels[0].set_ylabel('touchdowns' if result.is_rocket else 'episodes')
    crashes = int((~landed).sum())
    figure.suptitle(
        f'{_subject(result)}: {"touchdowns" if result.is_rocket else "on the ground"}',
        fontweight='bold')
    handles = [Patch(color=GREEN, label=f'{int(landed.sum())} landed')]
    if crashes:
        handles.append(Patch(color=VERMILION, label=f'{crashes} crashed'))
    figure.legend(handles=handles, loc='outside lower center', ncols=2)


def _footprint(figure: Figure, result: EvaluationResult) -> None:
    """Where they touched down: the whole pad, and the middle of it magnified."""
    ground, colours = touchdowns(result), _colours(result)
    radius = result.settings.get('landed_distance', 15.0)
    whole, near = figure.subplots(1, 2)
    inner = 1.15 * float(np.quantile(result.episodes.distance[ground], 0.99))
    inner = max(inner, 1e-6)
    far = 1.05 * max(radius, float(result.episodes.distance[ground].max()))
    for axes, reach, size in ((whole, far, 9), (near, inner, 5)):
        axes.add_patch(Circle((0, 0), radius, facecolor='#F4F4F4', edgecolor=INK, lw=1.2))
        for name in result.spec.outcomes:
            chosen = ground & result.named(name)
            if chosen.any():
                axes.plot(*result.end_position[chosen].T, '.', ms=size, alpha=0.5, mew=0,
                          color=colours[name], label=name.replace('_', ' '))
        axes.plot(0, 0, '+', color=INK, ms=14, mew=1, zorder=1)
        axes.set_aspect('equal')
        axes.set_xlim(-reach, reach)
        axes.set_ylim(reach, -reach)  # z towards the reader, as seen from above with y up
        axes.xaxis.set_major_locator(MaxNLocator(6))
        axes.yaxis.set_major_locator(MaxNLocator(6))
        axes.set_xlabel('x (m)')
        axes.set_ylabel('z (m)')
    whole.set_title(f'pad, radius {radius:g} m', fontsize=10.5, fontweight='normal')
    near.set_title('the middle, with 99 % of touchdowns', fontsize=10.5, fontweight='normal')
    figure.suptitle(f'{_subject(result)}: where {int(ground.sum())} rockets touched down',
                    fontweight='bold')
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=len(handles))


def _fuel(figure: Figure, result: EvaluationResult) -> None:
    """Fuel of each episode against the least that a straight drop from its start would take."""
    axes, colours = figure.subplots(), _colours(result)
    speed = -result.first_velocity_y
    for name in result.spec.outcomes:
        chosen = result.named(name)
        if chosen.any():
            axes.plot(speed[chosen], result.episodes.fuel_used[chosen], '.', ms=4, alpha=0.5,
                      mew=0, color=colours[name], label=name.replace('_', ' '))
    order = np.argsort(speed)
    axes.plot(speed[order], result.fuel_bound[order], '-', color=INK, lw=2,
              label='least of a straight drop')
    axes.set_xlabel('downward speed at the start (m/s)')
    axes.set_ylabel('fuel used (kg)')
    landed = result.landed
    ratio = result.episodes.fuel_used[landed] / result.fuel_bound[landed]
    note = f'{ratio.mean():.3f} times the least' if landed.any() else 'none landed'
    axes.set_title(f'{_subject(result)}: fuel, {note}')
    figure.legend(loc='outside lower center', markerscale=3, ncols=4)
