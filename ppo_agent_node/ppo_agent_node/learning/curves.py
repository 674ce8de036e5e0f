# SPDX-License-Identifier: Apache-2.0
"""Pictures of a training run, drawn from its `train.jsonl` alone."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ppo_agent_node.learning.run_folder import read_log
from ppo_agent_node.learning.scores import WINDOW
from ppo_agent_node.learning.scores import moving_average

# Okabe and Ito, 'Color universal design', 2008: told apart by every eye.
BLUE, ORANGE, GREEN, RED, GREY = '#0072B2', '#E69F00', '#009E73', '#D55E00', '#999999'
_SMOOTHING = 0.2
F64 = NDArray[np.float64]
Lines = list[dict[str, Any]]


def draw(log: Path, folder: Path) -> list[Path]:
    """Draw what a log has to show and return the pictures' paths.

    :raises ValueError: when the log is damaged.
    :raises OSError: when a picture cannot be written.
    """
    lines = read_log(log)
    cloning = [line for line in lines if line['stage'] == 'clone']
    tuning = [line for line in lines if line['stage'] == 'finetune']
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    if cloning:
        pictures.append(_save(cloning_figure(cloning), folder / 'cloning.png'))
    if len(tuning) > 1:
        pictures.append(_save(training_figure(tuning), folder / 'training.png'))
        pictures.append(_save(diagnostics_figure(tuning[1:]), folder / 'diagnostics.png'))
    scores = np.array([score for line in tuning for score in line.get('scores', ())], np.float64)
    if scores.size:
        pictures.append(_save(score_figure(scores), folder / 'score.png'))
    return pictures


def cloning_figure(lines: Lines) -> Figure:
    """Return training and validation loss over the epochs."""
    figure = Figure(figsize=(7, 4), layout='constrained')
    axes = figure.add_subplot()
    epoch = _column(lines, 'iteration')
    validation = _column(lines, 'clone_validation_loss')
    axes.plot(epoch, _column(lines, 'clone_loss'), color=BLUE, marker='o', ms=3,
              label='training')
    axes.plot(epoch, validation, color=RED, marker='s', ms=3, label='validation, other episodes')
    best = int(np.argmin(validation))
    axes.plot(epoch[best], validation[best], color=RED, marker='*', ms=14, ls='', label='kept')
    _dress(axes, 'epoch', 'loss of imitation', 'Cloning the expert')
    axes.set_yscale('log')
    axes.legend(frameon=False)
    return figure


def training_figure(lines: Lines) -> Figure:
    """Return mean return, landing rate and, where there are any, level over the iterations."""
    levels = _column(lines, 'level')
    parts = 3 if (levels > 0).any() else 2
    figure = Figure(figsize=(8, 8), layout='constrained')
    returns, landing, *level = figure.subplots(
        parts, 1, sharex=True, height_ratios=(3, 2, 1)[:parts])
    alone = 'final level, without noise' if level else 'without noise'
    iteration = _column(lines, 'iteration')
    raw = _column(lines, 'mean_return')
    returns.plot(iteration, raw, color=BLUE, alpha=0.35, lw=1, label='roll-out, with noise')
    returns.plot(iteration, smooth(raw), color=BLUE, label='the same, smoothed')
    selection = _column(lines, 'selection_return')
    flown = np.isfinite(selection)
    returns.plot(iteration[flown], selection[flown], color=RED, marker='o', ms=4, label=alone)
    _dress(returns, '', 'return of an episode', 'Fine-tuning by PPO')
    returns.legend(frameon=False, loc='lower right')
    landing.fill_between(
        iteration, 100 * _column(lines, 'landing_rate_low'),
        100 * _column(lines, 'landing_rate_high'), color=GREEN, alpha=0.25, lw=0,
        label='95 % interval (Wilson)')
    landing.plot(iteration, 100 * _column(lines, 'landing_rate'), color=GREEN,
                 label='roll-out, with noise')
    landing.plot(iteration[flown], 100 * _column(lines, 'selection_landing_rate')[flown],
                 color=RED, marker='o', ms=4, label=alone)
    _dress(landing, '' if level else 'iteration', 'landed, % of episodes')
    landing.legend(frameon=False, loc='lower right')
    for axes in level:
        axes.step(iteration, levels, where='mid', color=ORANGE)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        _dress(axes, 'iteration', 'curriculum level')
    return figure


def score_figure(scores: F64) -> Figure:
    """Return the return of each episode of fine-tuning, and its moving average.

    :param scores: `(K,)` in the order in which the episodes ended.
    """
    figure = Figure(figsize=(9, 4.5), layout='constrained')
    axes = figure.add_subplot()
    episode = np.arange(1, len(scores) + 1)
    axes.plot(episode, scores, color=BLUE, alpha=0.4, lw=0.8, label='score')
    axes.plot(episode, moving_average(scores), color=RED, lw=1.5,
              label=f'average of the last {WINDOW}')
    _dress(axes, 'episode', 'score', 'Training, episode by episode')
    axes.legend(frameon=False, loc='lower right')
    return figure


def diagnostics_figure(lines: Lines) -> Figure:
    """Return the update's diagnostics over the iterations."""
    figure = Figure(figsize=(10, 8), layout='constrained')
    iteration = _column(lines, 'iteration')
    panels = (
        ('policy_loss', 'policy loss', ''), ('value_loss', 'value loss', 'log'),
        ('explained_variance', 'explained variance', ''),
        ('approx_kl', 'approx. KL, nats', ''),
        ('clipfrac', 'clip fraction', ''), ('entropy', 'entropy, nats', ''),
        ('learning_rate', 'learning rate', ''), ('log_std', 'log standard deviation', ''),
    )
    grid = figure.subplots(4, 2, sharex=True)
    for axes, (name, label, scale) in zip(grid.flat, panels, strict=True):
        values = _column(lines, name)
        if not np.isfinite(values).any() and name == 'log_std':
            axes.remove()  # a categorical policy has none
            continue
        axes.plot(iteration, values, color=BLUE, lw=1.2)
        if scale and (values[np.isfinite(values)] > 0).any():
            axes.set_yscale(scale)
        if name == 'explained_variance':
            axes.set_ylim(-1.05, 1.05)
            axes.axhline(0, color=GREY, lw=0.8)
        _dress(axes, 'iteration' if axes in grid[-1] else '', label)
    figure.suptitle('What the updates did')
    return figure


def smooth(values: F64) -> F64:
    """Return the exponential moving average, NaN left out."""
    out = np.full_like(values, np.nan)
    mean = np.nan
    for index, value in enumerate(values):
        if np.isfinite(value):
            mean = value if np.isnan(mean) else mean + _SMOOTHING * (value - mean)
        out[index] = mean
    return out


def _column(lines: Lines, name: str) -> F64:
    """Return an entry of all lines, NaN where it is missing."""
    return np.array([
        np.nan if line.get(name) is None else float(line[name]) for line in lines])


def _dress(axes: Axes, x: str, y: str, title: str = '') -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.25)
    axes.spines[['top', 'right']].set_visible(False)


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path
