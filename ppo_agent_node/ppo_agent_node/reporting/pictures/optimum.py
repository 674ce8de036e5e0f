# SPDX-License-Identifier: Apache-2.0
"""Picture of landings' fuel and time relative to the optimum of their starts."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ppo_agent_node.evaluation.episode_table import OPTIMUM
from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.reporting.pictures.flights import subject
from ppo_agent_node.reporting.pictures.style import BLUE
from ppo_agent_node.reporting.pictures.style import INK
from ppo_agent_node.reporting.pictures.style import ORANGE
from rocket_sim_node.worlds.base import F64


def optimum_figure(figures: Mapping[str, Any], episodes: EpisodeTable) -> Figure | None:
    """Return fuel and time beyond the optimum, start by start; None if none was solved."""
    if any(name not in episodes.numbers for name in OPTIMUM):
        return None
    fuel, steps = (episodes.numbers[name] for name in OPTIMUM)
    solved = np.isfinite(fuel)
    shown = solved & episodes.named('landed')
    if not shown.any():
        return None
    panels = (
        ('fuel', episodes.numbers['fuel_used_kg'][shown], fuel[shown], BLUE),
        ('time', episodes.numbers['length_steps'][shown], steps[shown], ORANGE))
    figure = Figure(figsize=(10.5, 4.8))
    for axes, (what, used, least, colour) in zip(figure.subplots(1, 2), panels, strict=True):
        _bars(axes, 100 * (used / least - 1), what, colour)
    left = int(solved.sum() - shown.sum())
    figure.suptitle(
        f'{subject(figures)}: {int(shown.sum())} landings compared with the optimum'
        + (f' ({left} more flights failed)' if left else ''), x=0.01, ha='left')
    return figure


def _bars(axes: Axes, excess: F64, what: str, colour: str) -> None:
    """Draw the excess of landings over the optimum, %, in order."""
    place = np.arange(1, len(excess) + 1)
    axes.bar(place, np.sort(excess), color=colour)
    axes.axhline(0.0, color=INK, lw=2)
    axes.axhline(float(excess.mean()), color=INK, lw=1.2, ls='--')
    axes.set_xlabel('landings, sorted')
    axes.set_ylabel(f'{what} beyond the optimum (%)')
    axes.set_xlim(0.3, len(excess) + 0.7)
    axes.set_title(
        f'excess {what}: mean {excess.mean():.2f} % (dashed), maximum {excess.max():.2f} %',
        fontsize=10, fontweight='normal')
