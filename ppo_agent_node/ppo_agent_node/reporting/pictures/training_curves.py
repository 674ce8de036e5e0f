# SPDX-License-Identifier: Apache-2.0
"""Pictures of a training run, drawn from the lines of its `train.jsonl`."""
from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from ppo_agent_node.reporting.pictures.style import BLUE
from ppo_agent_node.reporting.pictures.style import GREEN
from ppo_agent_node.reporting.pictures.style import GREY
from ppo_agent_node.reporting.pictures.style import ORANGE
from ppo_agent_node.reporting.pictures.style import VERMILION
from ppo_agent_node.reporting.pictures.style import whole_ticks
from ppo_agent_node.reporting.run_files import Lines
from ppo_agent_node.reporting.run_files import column
from ppo_agent_node.runs.episode_scores import WINDOW
from ppo_agent_node.runs.episode_scores import moving_average
from rocket_sim_node.worlds.base import F64

SMOOTHING = 0.2
"""Weight of the newest value in a smoothed curve."""


def cloning_figure(lines: Lines) -> Figure:
    """Return training and validation loss over the epochs.

    Each round of DAgger is labelled with the landing rate of the clone that flew it. Each round
    adds samples, so only losses of the same round are comparable, and the last clone is kept.
    """
    figure = Figure(figsize=(8, 4.2))
    axes = figure.add_subplot()
    epoch = column(lines, 'iteration')
    validation = column(lines, 'clone_validation_loss')
    axes.plot(epoch, column(lines, 'clone_loss'), color=BLUE, marker='o', ms=4,
              label='training')
    axes.plot(epoch, validation, color=VERMILION, marker='s', ms=4,
              label='validation, held-out episodes')
    rounds = np.flatnonzero(np.isfinite(column(lines, 'dagger_round')))
    landed = column(lines, 'landing_rate')
    for number in rounds:
        axes.axvline(epoch[number] - 0.5, color=GREY, lw=0.8, ls=':')
        axes.annotate(f'{100 * landed[number]:.0f} % landed', (epoch[number] - 0.5, 0.98),
                      xycoords=('data', 'axes fraction'), rotation=90, ha='right', va='top',
                      fontsize=8)
    first = int(rounds[-1]) if len(rounds) else 0
    if np.isfinite(validation[first:]).any():
        best = first + int(np.nanargmin(validation[first:]))
        axes.plot(epoch[best], validation[best], color=VERMILION, marker='*', ms=15, ls='',
                  label='kept policy')
    title = 'Loss of the clone in each epoch'
    if len(rounds) == 1:
        title = f'Before its round of DAgger the clone lands {100 * landed[rounds[0]]:.0f} %'
    elif len(rounds):
        title = (f'With DAgger the clone lands {100 * landed[rounds[-1]]:.0f} % instead of '
                 f'{100 * landed[rounds[0]]:.0f} %')
    _dress(axes, 'epoch', 'loss (no unit)', title)
    axes.set_yscale('log')
    axes.margins(y=0.3)  # room for the labels of the rounds above the curves
    figure.legend(loc='outside lower center', ncols=3)
    return figure


def training_figure(lines: Lines) -> Figure:
    """Return mean return and landing rate over the iterations.

    The level and the reach of a reverse curriculum are drawn below if they change.
    """
    level, reach = column(lines, 'level'), column(lines, 'reach')
    curricula = [
        (values, label, scale) for values, label, scale in (
            (level, 'level\n(1 to 8)', 'linear'), (reach, 'highest\nstart (m)', 'log'))
        if _varies(values)]
    figure = Figure(figsize=(9, 8.4))
    returns, landing, *below = figure.subplots(
        2 + len(curricula), 1, sharex=True, height_ratios=(3, 2, 1, 1)[:2 + len(curricula)])
    task = 'whole task, ' if np.isfinite(reach).any() else 'final level, ' if _varies(
        level) else ''
    alone = f'{task}without noise'
    iteration = column(lines, 'iteration')
    raw = column(lines, 'mean_return')
    returns.plot(iteration, raw, color=BLUE, alpha=0.4, lw=1, label='roll-out, with noise')
    returns.plot(iteration, smooth(raw), color=BLUE, lw=1.8, label='the same, smoothed')
    selection = column(lines, 'selection_return')
    flown = np.isfinite(selection)
    returns.plot(iteration[flown], selection[flown], color=VERMILION, marker='o', ms=4,
                 label=alone)
    _show_most(returns, raw, selection[flown])
    _dress(returns, '', 'mean return (reward points)')
    _legend_above(returns)
    landing.plot(iteration, 100 * column(lines, 'landing_rate'), color=GREEN, lw=1.2, zorder=4,
                 label='roll-out, with noise')
    landing.fill_between(
        iteration, 100 * column(lines, 'landing_rate_low'),
        100 * column(lines, 'landing_rate_high'), color=GREEN, alpha=0.25, lw=0,
        label='95 % interval of the roll-out (Wilson)')
    landing.plot(iteration[flown], 100 * column(lines, 'selection_landing_rate')[flown],
                 color=VERMILION, marker='o', ms=5, lw=3.2, label=alone)
    _dress(landing, '' if below else 'iteration', 'landed (% of episodes)')
    _legend_above(landing)
    for axes, (values, label, scale) in zip(below, curricula, strict=True):
        axes.step(iteration, values, where='mid', color=ORANGE, lw=1.8)
        axes.set_yscale(scale)
        if scale == 'linear':
            axes.yaxis.set_major_locator(MultipleLocator(1))
            axes.set_ylim(np.nanmin(values) - 0.6, np.nanmax(values) + 0.6)
        _dress(axes, 'iteration' if axes is below[-1] else '', label)
    figure.align_ylabels()
    title = 'Return and landing rate during PPO'
    if flown.sum() > 1:
        first, best = selection[flown][0], np.max(selection[flown])
        title = (
            f'PPO raises the return without noise from {first:.2f} to {best:.2f}' if best > first
            else f'PPO does not raise the return without noise above {first:.2f}')
    figure.suptitle(title, x=0.01, ha='left')
    return figure


def _varies(values: F64) -> bool:
    """Return whether there are different values, besides NaN."""
    return bool(np.nanmax(values, initial=-np.inf) > np.nanmin(values, initial=np.inf))


def _show_most(axes: Axes, raw: F64, selection: F64) -> None:
    """Clip a few bad roll-outs at the lower edge, as they would flatten the curves.

    One start from which no landing is possible, flown by all its copies, costs a roll-out six
    points.
    """
    shown = raw[np.isfinite(raw)]
    if shown.size < 20:
        return
    low, high = np.quantile(shown, 0.05), shown.max()
    if selection.size:
        low, high = min(low, selection.min()), max(high, selection.max())
    if shown.min() < low - (high - low):
        axes.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))


def score_figure(scores: F64) -> Figure:
    """Return the return of each episode of fine-tuning, and its moving average.

    :param scores: `(K,)` in the order in which the episodes ended.
    """
    figure = Figure(figsize=(9, 4.5))
    axes = figure.add_subplot()
    episode = np.arange(1, len(scores) + 1)
    axes.plot(episode, scores, color=BLUE, alpha=0.4, lw=0.8, label='score of an episode')
    axes.plot(episode, moving_average(scores), color=VERMILION, lw=1.8,
              label=f'average of the last {WINDOW}')
    _dress(
        axes, 'episode', 'score (reward points)',
        f'Score of {len(scores)} training episodes; average of the last {WINDOW}: '
        f'{moving_average(scores)[-1]:.1f}')
    figure.legend(loc='outside lower center', ncols=2)
    return figure


def diagnostics_figure(lines: Lines) -> Figure:
    """Return the update's diagnostics over the iterations."""
    panels = [
        ('policy_loss', 'policy loss'), ('value_loss', 'value loss'),
        ('explained_variance', 'explained variance'), ('approx_kl', 'approx. KL (nats)'),
        ('clipfrac', 'clipped (% of samples)'), ('entropy', 'entropy (nats)'),
        ('learning_rate', 'learning rate'), ('log_std', 'ln of std. deviation'),
    ]
    # A categorical policy has no standard deviation; other entries are missing during warm-up
    # only.
    panels = [panel for panel in panels
              if panel[0] != 'log_std' or np.isfinite(column(lines, panel[0])).any()]
    figure = Figure(figsize=(10, 8.4))
    grid = figure.subplots(4, 2, sharex=True)
    iteration = column(lines, 'iteration')
    for axes, (name, label) in zip(grid.flat, panels, strict=False):
        values = (100 if name == 'clipfrac' else 1) * column(lines, name)
        axes.plot(iteration, values, color=BLUE, lw=1.3)
        if name == 'value_loss' and (values[np.isfinite(values)] > 0).any():
            axes.set_yscale('log')
        if name == 'explained_variance':
            axes.set_ylim(-1.05, 1.05)
            axes.axhline(0, color=GREY, lw=0.8)
        _dress(axes, 'iteration' if axes in grid[-1] else '', label)
    for axes in grid.flat[len(panels):]:
        axes.remove()
        grid[-2, 1].set_xlabel('iteration')
        grid[-2, 1].xaxis.set_tick_params(labelbottom=True)
    figure.align_ylabels()
    figure.suptitle(
        'Losses, divergence, entropy and learning rate of each iteration', x=0.01, ha='left')
    return figure


def smooth(values: F64) -> F64:
    """Return the exponential moving average `(K,)`, ignoring NaN."""
    out = np.full_like(values, np.nan)
    mean = np.nan
    for index, value in enumerate(values):
        if np.isfinite(value):
            mean = value if np.isnan(mean) else mean + SMOOTHING * (value - mean)
        out[index] = mean
    return out


def _legend_above(axes: Axes) -> None:
    """Place the legend above the curves."""
    axes.legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)


def _dress(axes: Axes, x: str, y: str, title: str = '') -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title)
    whole_ticks(axes)
