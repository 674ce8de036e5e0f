# SPDX-License-Identifier: Apache-2.0
"""Landing rate as a function of the initial conditions."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ppo_agent_node.evaluation.episode_table import START
from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.flights import subject
from ppo_agent_node.reporting.pictures.style import BLUE
from ppo_agent_node.statistics import wilson
from rocket_sim_node.palette import words
from rocket_sim_node.worlds.base import F64

MOST_BINS, LEAST_EPISODES = 10, 25
"""Maximum bins of a condition, and minimum episodes of a bin, if there are enough."""
_COLUMNS = 3
_UNITS = {'_rad_s': ' (rad/s)', '_m_s': ' (m/s)', '_deg': ' (deg)', '_m': ' (m)'}
_LABELS = {
    'start_height_m': 'height', 'start_descent_m_s': 'downward speed',
    'start_offset_m': 'horizontal offset from the pad', 'start_drift_m_s': 'horizontal speed',
    'start_tilt_deg': 'tilt from vertical', 'start_spin_rad_s': 'spin',
    'start_velocity_x_m_s': 'speed to the right', 'start_velocity_y_m_s': 'speed upwards',
    'start_speed_m_s': 'speed',
}


@dataclass(frozen=True)
class BinnedRate:
    """Landing rates over B bins of a condition with nearly equal numbers of episodes."""

    edges: F64
    """`(B + 1,)`."""
    landed: NDArray[np.int64]
    """`(B,)`."""
    flown: NDArray[np.int64]
    """`(B,)`."""

    @property
    def rate(self) -> F64:
        """Landing rates `(B,)`, 0 to 1."""
        return self.landed / self.flown

    @property
    def interval(self) -> F64:
        """Wilson's 95 % intervals `(B, 2)`."""
        return np.array([
            wilson(landed, flown) for landed, flown in zip(
                self.landed.tolist(), self.flown.tolist(), strict=True)])


def binned(values: F64, landed: NDArray[np.bool_]) -> BinnedRate:
    """Return the landing rate by bins of a condition; equal values share a bin.

    :param values: `(K,)` the condition, K at least 1.
    :param landed: `(K,)`.
    """
    bins = max(1, min(MOST_BINS, len(values) // LEAST_EPISODES))
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
    if len(edges) < 2:
        edges = np.array([edges[0], edges[0]])
    place = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, len(edges) - 2)
    flown = np.bincount(place, minlength=len(edges) - 1)
    there = flown > 0
    return BinnedRate(
        np.append(edges[:-1][there], edges[-1]),
        np.bincount(place[landed], minlength=len(edges) - 1)[there], flown[there])


def varying(episodes: EpisodeTable) -> dict[str, F64]:
    """Return the initial conditions that differ between episodes."""
    return {
        name: values for name, values in episodes.starts.items()
        if np.isfinite(values).all()
        and np.ptp(values) > 1e-4 * max(1.0, float(np.abs(values).max()))}


def label(name: str) -> str:
    """Return a column's name as text with its unit."""
    unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), '')
    what = _LABELS.get(name) or style.plain(words(name.removeprefix(START)))
    return f'{what} at the start{unit}'


def conditions_figure(figures: Mapping[str, Any], episodes: EpisodeTable) -> Figure | None:
    """Return the landing rate over each condition that varies; None if none does."""
    conditions = varying(episodes)
    if not conditions:
        return None
    columns = min(_COLUMNS, len(conditions))
    rows = -(-len(conditions) // columns)
    figure = Figure(figsize=(max(3.9 * columns, 7.0), 3.3 * rows + 0.8))
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
    landed, lowest = episodes.named('landed'), 1.0
    for axes, (name, values) in zip(grid.flat, conditions.items(), strict=False):
        rates = binned(values, landed)
        lowest = min(lowest, float(rates.interval[:, 0].min()))
        _draw(axes, rates)
        axes.set_xlabel(label(name))
    for axes in grid.flat[len(conditions):]:
        axes.remove()
    for axes in grid[:, 0]:
        axes.set_ylabel('landed (% of episodes)')
    room = max(100 * (1 - lowest), 0.5)
    grid[0, 0].set_ylim(max(100 - 1.08 * room, -1.0), 100 + 0.05 * room)
    low, high = figures['landing_rate_interval']
    figure.suptitle(
        f'{subject(figures)}: landing rate by initial condition', x=0.01, ha='left')
    figure.legend(
        *grid[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=2)
    for axes in grid.flat[:len(conditions)]:
        axes.axhspan(100 * low, 100 * high, color=style.GREY, alpha=0.35, lw=0, zorder=0)
    return figure


def _draw(axes: Axes, rates: BinnedRate) -> None:
    """Draw the rate of each bin over its width, with the interval."""
    left, right = rates.edges[:-1], rates.edges[1:]
    rate = 100 * rates.rate
    low, high = 100 * rates.interval.T
    axes.hlines(rate, left, right, color=BLUE, lw=1.2)
    axes.errorbar(
        (left + right) / 2, rate, (np.maximum(rate - low, 0), np.maximum(high - rate, 0)),
        color=BLUE, fmt='o', ms=5, lw=1.5, capsize=3.5,
        label='landing rate of a bin with its 95 % interval (Wilson)')
    axes.plot([], [], color=style.GREY, lw=8, alpha=0.5, label='95 % interval for all episodes')
    axes.tick_params(labelleft=True)
