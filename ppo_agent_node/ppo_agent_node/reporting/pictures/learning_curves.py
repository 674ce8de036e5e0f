# SPDX-License-Identifier: Apache-2.0
"""Learning curves of several runs, grouped by settings, with a band over the seeds."""
from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.training_curves import smooth
from ppo_agent_node.reporting.run_files import Run
from ppo_agent_node.reporting.run_files import column
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.registry import added_settings

POINTS = 200
"""Number of points of a band."""
_NAMED = 3
"""Maximum number of settings in a label."""
_MISSING = 'not set'
_FIRST = ('world', 'pilot', 'level')
_IRRELEVANT = {'seed', 'plots', 'checkpoint_interval'}
"""Settings that do not part groups."""


@dataclass(frozen=True)
class Group:
    """Runs with equal settings, apart from the seed and what no curve or figure depends on."""

    mark: str
    """A letter, '' if there is one group only."""
    label: str
    runs: tuple[Run, ...]

    @property
    def title(self) -> str:
        """Mark and label."""
        return f'{self.mark}: {self.label}' if self.mark else self.label


@dataclass(frozen=True)
class Curve:
    """One quantity of one run, `(K,)`, K at least 1, all finite."""

    x: F64
    y: F64


@dataclass(frozen=True)
class Band:
    """Median and range over the seeds, on a grid `(POINTS,)` that all of them cover."""

    x: F64
    median: F64
    low: F64
    high: F64


def settings(run: Run) -> dict[str, str]:
    """Return the settings of a run that part groups, as text by name."""
    flown = run.figures or {}
    values: dict[str, Any] = {
        'world': run.world, 'num_envs': run.config.get('num_envs', flown.get('num_envs'))}
    values |= {
        name: value for name, value in run.training.items()
        if name not in _IRRELEVANT}
    if not run.training:  # an evaluation alone
        values |= {'pilot': flown.get('policy'), 'level': flown.get('level')}
    trained_in = run.config.get('world_settings') or run.world_settings
    if trained_in:  # also by an older version
        values |= {f'world.{name}': value for name, value in {
            **added_settings(run.world), **trained_in}.items()}
    return {
        name: value if isinstance(value, str) else json.dumps(value, default=str)
        for name, value in values.items()}


def groups(runs: Sequence[Run]) -> list[Group]:
    """Return the runs grouped by settings except the seed, in order, labelled by differences."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(json.dumps(settings(run), sort_keys=True), []).append(run)
    if len(found) == 1:
        return [Group('', runs[0].world or 'all runs', tuple(runs))]
    labels = _labels([settings(members[0]) for members in found.values()])
    return [
        Group(_mark(place), label, tuple(members))
        for place, (label, members) in enumerate(zip(labels, found.values(), strict=True))]


def _mark(place: int) -> str:
    """Return A, B, to Z, then A1, B1 and so on."""
    turn, letter = divmod(place, 26)
    return f'{chr(ord("A") + letter)}{turn or ""}'


def _labels(texts: Sequence[dict[str, str]]) -> list[str]:
    """Return a label for each of several settings: what distinguishes them, and a little more."""
    names = list(dict.fromkeys(name for text in texts for name in text))
    differing = [name for name in names if len({text.get(name) for text in texts}) > 1]
    # Settings that some runs lack, as they are older or of another kind, come last.
    differing.sort(key=lambda name: (
        name not in _FIRST, any(name not in text for text in texts)))

    def told_apart(chosen: Sequence[str]) -> int:
        return len({tuple(text.get(name) for name in chosen) for text in texts})

    chosen: list[str] = []
    for name in differing:
        if told_apart([*chosen, name]) > told_apart(chosen):
            chosen.append(name)
    chosen += [name for name in differing if name not in chosen][:max(0, _NAMED - len(chosen))]
    more = f' and {len(differing) - len(chosen)} more' if len(differing) > len(chosen) else ''
    return [', '.join(
        text['world'] if name == 'world' else f'{name} {text.get(name, _MISSING)}'
        for name in chosen if name in text or _comparable(name, text)) + more for text in texts]


def _comparable(name: str, text: dict[str, str]) -> bool:
    """Return whether a setting missing in `text` should be labelled so, not just inapplicable."""
    return name not in _FIRST and 'pilot' not in text


def curve(run: Run, name: str, by_time: bool = False) -> Curve | None:
    """Return an entry of fine-tuning over environment steps or wall clock; None if missing.

    :param by_time: over min since the run began, demonstrations and cloning included.
    """
    elapsed = np.cumsum(np.nan_to_num(column(run.lines, 'seconds'))) / 60
    tuning = np.array([line['stage'] == 'finetune' for line in run.lines], np.bool_)
    lines = run.stage('finetune')
    x, y = elapsed[tuning] if by_time else column(lines, 'steps'), column(lines, name)
    known = np.isfinite(x) & np.isfinite(y)
    return Curve(x[known], y[known]) if known.any() else None


def band(curves: Sequence[Curve]) -> Band | None:
    """Return median, minimum and maximum of curves where all are defined; None if nowhere."""
    first = max(one.x[0] for one in curves)
    last = min(one.x[-1] for one in curves)
    if last <= first:
        return None
    x = np.linspace(first, last, POINTS)
    all_y = np.stack([np.interp(x, one.x, one.y) for one in curves])
    return Band(x, np.median(all_y, axis=0), all_y.min(axis=0), all_y.max(axis=0))


_ROWS = (
    ('selection_return', 'mean return,\nwithout noise\n(reward points)', 1.0, False),
    ('mean_return', 'mean return,\nroll-out, smoothed\n(reward points)', 1.0, True),
    ('landing_rate', 'landed,\nroll-out, smoothed\n(% of episodes)', 100.0, True),
)
_COLUMNS = (('environment steps (millions)', 1e-6, False), ('wall clock (min)', 1.0, True))


def seeds_figure(found: Sequence[Group]) -> Figure | None:
    """Return learning curves of all groups; None if no run has fine-tuned yet."""
    figure = Figure(figsize=(11, 9))
    grid = figure.subplots(len(_ROWS), len(_COLUMNS), sharey='row', sharex='col')
    drawn = False
    for panels, (name, what, factor, smoothed) in zip(grid, _ROWS, strict=True):
        for axes, (where, unit, by_time) in zip(panels, _COLUMNS, strict=True):
            for group, colour in zip(found, style.CYCLE * len(found), strict=False):
                curves = [
                    Curve(unit * one.x, factor * (smooth(one.y) if smoothed else one.y))
                    for run in group.runs if (one := curve(run, name, by_time)) is not None]
                drawn = _draw(axes, curves, group, colour) or drawn
            if axes in grid[-1]:
                axes.set_xlabel(where)
        panels[0].set_ylabel(what)
    if not drawn:
        return None
    named: dict[str, Any] = {}
    for axes in grid.flat:  # a group may lack a quantity that is shown
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(text, handle)
    texts = [text for group in found if (text := _name(group)) in named]
    figure.legend(
        [named[text] for text in texts], texts, loc='outside lower center', ncols=1)
    figure.align_ylabels()
    figure.suptitle(
        'Learning curves: median (line) and range (band) over the seeds; thin lines: single seeds',
        x=0.01, ha='left')
    return figure


def _draw(axes: Axes, curves: Sequence[Curve], group: Group, colour: str) -> bool:
    """Draw a group's curves and, where several overlap, their band; return whether it had any."""
    lines = [axes.plot(one.x, one.y, color=colour, lw=0.8, alpha=0.45)[0] for one in curves]
    over = band(curves) if len(curves) > 1 else None
    if over is not None:
        axes.fill_between(over.x, over.low, over.high, color=colour, alpha=0.2, lw=0)
        lines = axes.plot(over.x, over.median, color=colour, lw=2.2)
    elif len(curves) == 1:
        lines[0].set(linewidth=1.6, alpha=1.0)
    for line in lines[:1]:
        line.set_label(_name(group))
    return bool(curves)


def _name(group: Group) -> str:
    """Return a group's name in the legend."""
    count = len(group.runs)
    return style.plain(f'{group.title} ({count} seed{"s" if count > 1 else ""})')
