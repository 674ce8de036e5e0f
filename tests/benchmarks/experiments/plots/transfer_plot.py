# SPDX-License-Identifier: Apache-2.0
"""The plot of `experiments transfer`: a matrix of mean returns, one panel per world."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from benchmarks.experiments import transfer
from ppo_agent_node.reporting.pictures import style

_BOUNDS = (-100, 0, 100, 200, 240, 260, 280, 290, 300)
_BRIGHT = 0.5
"""Luminance above which text is dark."""


def title(figures: Mapping[str, Any]) -> str:
    """Return a one-line summary of the results in the other world and under the mix."""
    lost = []
    for home in transfer.WORLDS:
        away, = (world for world in transfer.WORLDS if world != home)
        if (home, home) in transfer.columns(figures):
            lost.append(
                transfer.cell(figures, (away, 'expert'), 'nominal')['mean_return']
                - transfer.cell(figures, (away, home), 'nominal')['mean_return'])
    on_mix = {column[1]: transfer.cell(figures, column, 'mix')['mean_return']
              for column in transfer.columns(figures) if column[0] == transfer.WORLDS[0]}
    best = max(on_mix, key=lambda pilot: on_mix[pilot])
    return (f'In the other world policies return up to {max(lost):.1f} less than its expert; '
            f'on the mix {best} leads, {on_mix[best]:.1f}')


def draw(figures: Mapping[str, Any], path: Path) -> Path:
    """Draw the plot."""
    with style.styled():
        conditions = transfer.rows(figures)
        figure = Figure(figsize=(9.5, 2.4 + 0.27 * len(conditions)))
        panels = figure.subplots(1, len(transfer.WORLDS), sharey=True)
        colours = ListedColormap(mpl.colormaps['cividis'](
            np.linspace(0.08, 1.0, len(_BOUNDS) - 1)))
        norm = BoundaryNorm(_BOUNDS, colours.N, clip=True)
        for panel, world in zip(panels, transfer.WORLDS, strict=True):
            pilots = [column for column in transfer.columns(figures) if column[0] == world]
            values = np.array([[
                transfer.cell(figures, column, condition)['mean_return'] for column in pilots]
                for condition in conditions])
            panel.imshow(values, aspect='auto', cmap=colours, norm=norm)
            _write(panel, values, colours(norm(values)))
            panel.set_title(f'flown in {world}', fontsize=10.5)
            panel.set_xticks(
                range(len(pilots)), [style.plain(pilot) for _, pilot in pilots], rotation=25,
                ha='right', rotation_mode='anchor')
            panel.set_yticks(range(len(conditions)), [style.plain(text) for text in conditions])
            panel.tick_params(length=0, labelsize=9)
            panel.grid(visible=False)
            panel.spines[:].set_visible(False)
        scale = figure.colorbar(
            ScalarMappable(norm, colours), ax=list(panels), orientation='horizontal', pad=0.03,
            aspect=50, ticks=_BOUNDS, spacing='uniform', label='mean return of level 7')
        scale.outline.set_visible(False)
        figure.suptitle(title(figures), x=0.01, ha='left')
        return style.save(figure, path)


def _write(panel: Axes, values: np.ndarray, colour: np.ndarray) -> None:
    """Write each value into its cell, in a text colour that contrasts with `(R, C, 4)`."""
    bright = colour[..., :3] @ np.array((0.299, 0.587, 0.114)) > _BRIGHT
    for (row, column), value in np.ndenumerate(values):
        panel.text(column, row, f'{value:.1f}', ha='center', va='center', fontsize=8.5,
                   color=style.INK if bright[row, column] else 'white')
