# SPDX-License-Identifier: Apache-2.0
"""Page that compares runs: learning curves over seeds, and a table of all evaluations."""
from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ppo_agent_node.reporting.pages import figures_table
from ppo_agent_node.reporting.pages import html
from ppo_agent_node.reporting.pages.html import Markup
from ppo_agent_node.reporting.pages.run_page import REPORT
from ppo_agent_node.reporting.pictures.learning_curves import Group
from ppo_agent_node.reporting.run_files import Run

CAPTION = (
    'Left: by environment steps. Right: by wall clock. The thick line is the median over the '
    'seeds of a group, the band reaches from the lowest to the highest, and each seed is a thin '
    'line. Median and band are drawn only where every seed of the group has data.')
_HEAD = ('run', 'group', 'seed', 'landed', '95 % interval', 'mean return', '95 % interval',
         'touchdown speed, mean', 'fuel / optimum', 'steps', 'time')


def comparison_page(groups: Sequence[Group], curves: Path | None, folder: Path) -> str:
    """Return the page.

    :param curves: the picture of the learning curves, if there is one.
    :param folder: folder of the page; links to the runs' own pages are relative to it.
    """
    runs = [run for group in groups for run in group.runs]
    several = len(groups) > 1
    parts = [
        html.tag('h1', f'{len(runs)} runs compared'),
        html.tag('p', f'{len(groups)} groups of equal settings' if several
                 else 'One group: equal settings apart from the seed', class_='lead'),
        html.table(
            ('group', 'evaluated', 'landed, mean', 'lowest', 'mean return, median',
             'lowest to highest'), [_group_row(group) for group in groups], 'numbers')]
    if curves is not None:
        parts += [html.tag('h2', 'Learning curves over the seeds'),
                  html.figure(curves, 'Return and landing rate', CAPTION)]
    parts += [
        html.tag('h2', 'Runs'),
        html.table(_HEAD, [_row(run, group, folder) for group in groups for run in group.runs],
                   'numbers')]
    return html.document(f'{len(runs)} runs compared', *parts)


def _group_row(group: Group) -> tuple[str, ...]:
    """Return a group's figures over those of its seeds that were evaluated."""
    figures = [run.figures for run in group.runs if run.figures is not None]
    evaluated = f'{len(figures)} of {len(group.runs)}'
    if not figures:
        return group.title, evaluated, '', '', '', ''
    rates = [one['landing_rate'] for one in figures]
    returns = [one['mean_return'] for one in figures]
    return (
        group.title, evaluated, figures_table.rate(float(np.mean(rates))),
        figures_table.rate(min(rates)), f'{np.median(returns):.2f}',
        f'{min(returns):.2f} to {max(returns):.2f}')


def _row(run: Run, group: Group, folder: Path) -> tuple[object, ...]:
    """Return a run's figures, with its name as a link to its own page."""
    target = os.path.relpath(run.path.resolve() / REPORT, folder.resolve())
    link: Markup = html.tag('a', run.name, href=quote(f'./{target}'))
    seed = run.training.get('seed', '')
    steps = run.lines[-1].get('steps') if run.lines else None
    end = (
        f'{steps / 1e6:.2f} million' if isinstance(steps, int) else '',
        '' if run.seconds is None else figures_table.duration(run.seconds))
    if run.figures is None:
        return link, group.mark, seed, 'not evaluated', '', '', '', '', '', *end
    speed = (run.figures.get('touchdown_speed') or {}).get('mean')
    ratio = run.figures.get('fuel_ratio_optimum')
    low, high = run.figures['mean_return_interval']
    return (
        link, group.mark, seed, figures_table.rate(run.figures['landing_rate']),
        figures_table.interval_of_rate(run.figures, 'landing_rate'),
        f'{run.figures["mean_return"]:.2f}', f'{low:.2f} to {high:.2f}',
        '' if speed is None else f'{speed:.3g} m/s', '' if ratio is None else f'{ratio:.3f}', *end)
