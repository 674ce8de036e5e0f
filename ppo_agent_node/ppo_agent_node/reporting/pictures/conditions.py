# SPDX-License-Identifier: Apache-2.0
"""Heat maps of the table of conditions: one panel per figure and level, one column per pilot."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from ppo_agent_node.evaluation.conditions_files import cell_of
from ppo_agent_node.reporting.pictures.style import plain

_LEAST_WIDTH = 10.5
_ROW, _COLUMN = 0.26, 0.46
_LETTER = 0.06
"""Inches along the edge per letter of a name above a column."""
_MARGIN = 1.9
"""Inches for titles, names of pilots and the scale, and for names of conditions."""
_MIDDLE = 0.5
"""Luminance below which text is white."""
_DARK = '#111111'
_LONG = 12
"""Letters of a pilot's name that fit above its column."""


class _Figure(NamedTuple):
    """A figure of the cells, and its colour scale."""

    key: str
    title: str
    bounds: tuple[float, ...]
    """Edges of the colour bins; values beyond have the outermost colours."""
    factor: float
    """Factor of displayed values."""
    form: Callable[[float], str]
    """Formatter of values."""


def short_rate(value: float) -> str:
    """Return per cent with one digit; 100 and 0 are exact."""
    if value in (0.0, 100.0):
        return f'{value:.0f}'
    return {'100.0': '> 99.9', '0.0': '< 0.1'}.get(text := f'{value:.1f}', text)


def short_return(value: float) -> str:
    """Return a return with one digit, without it if crashes make the return negative."""
    return f'{value:.1f}' if value >= 0 else f'{value:.0f}'


_FIGURES = (
    _Figure('landing_rate', 'Landing rate (%)', (0, 50, 80, 90, 95, 98, 99, 99.9, 100), 100.0,
            short_rate),
    _Figure('mean_return', 'Mean return (reward points)',
            (-100, 0, 100, 200, 240, 260, 280, 290, 300), 1.0, short_return),
)


def heat_maps(table: Mapping[str, Any]) -> Figure:
    """Return the heat maps of a table of conditions.

    :param table: as in `conditions.json`.
    """
    pilots, levels = table['pilots'], len(table['levels'])
    # Slanted names extend beyond the right end of their panel.
    panel = _COLUMN * len(pilots) + (_LETTER * max(map(len, pilots)) if _slanted(pilots) else 0.1)
    width = max(_LEAST_WIDTH, _MARGIN + len(_FIGURES) * levels * panel)
    figure = Figure(figsize=(width, _MARGIN + _ROW * len(table['conditions'])))
    # Names of the conditions are shown on the left half only.
    plain_half = (width - _MARGIN) / len(_FIGURES)
    halves = figure.subfigures(
        1, len(_FIGURES), width_ratios=(plain_half + _MARGIN, plain_half), wspace=0.0,
        squeeze=False)
    for number, shown in enumerate(_FIGURES):
        _half(halves[0, number], table, shown, labelled=number == 0)
    return figure


def _half(half: SubFigure, table: Mapping[str, Any], shown: _Figure, *, labelled: bool) -> None:
    """Draw the panels of one figure, one per level, and its scale."""
    colours = ListedColormap(mpl.colormaps['cividis'](
        np.linspace(0.08, 1.0, len(shown.bounds) - 1)))
    norm = BoundaryNorm(shown.bounds, colours.N, clip=True)
    panels = half.subplots(1, len(table['levels']), squeeze=False)[0]
    half.suptitle(shown.title)
    for panel, level in zip(panels, table['levels'], strict=True):
        values = np.array([[
            shown.factor * cell_of(table, pilot, level, condition)[shown.key]
            for pilot in table['pilots']] for condition in table['conditions']])
        panel.imshow(values, aspect='auto', cmap=colours, norm=norm)
        _write(panel, values, colours, norm, shown.form)
        panel.set_title(f'level {level}', fontsize=10.5, loc='center', fontweight='normal')
        _name(panel, table['pilots'], table['conditions'] if labelled and panel is panels[0]
              else ())
    scale = half.colorbar(
        ScalarMappable(norm, colours), ax=list(panels), orientation='horizontal', pad=0.02,
        aspect=32, ticks=shown.bounds, spacing='uniform')
    scale.ax.set_xticklabels([f'{bound:g}' for bound in shown.bounds], fontsize=8.5)
    scale.outline.set_visible(False)


def _write(
    panel: Axes, values: NDArray[np.float64], colours: ListedColormap, norm: BoundaryNorm,
    form: Callable[[float], str],
) -> None:
    """Write each value in its cell."""
    light = colours(norm(values))[..., :3] @ np.array((0.299, 0.587, 0.114)) > _MIDDLE
    for (row, column), value in np.ndenumerate(values):
        panel.text(column, row, form(float(value)), ha='center', va='center', fontsize=8.5,
                   color=_DARK if light[row, column] else 'white')


def _name(panel: Axes, pilots: Sequence[str], conditions: Sequence[str]) -> None:
    """Label columns and rows, and draw white lines between cells."""
    slanted = _slanted(pilots)
    panel.set_xticks(
        range(len(pilots)), [plain(name) for name in pilots], fontsize=8.5,
        rotation=30 if slanted else 0, ha='left' if slanted else 'center')
    panel.xaxis.tick_top()
    panel.set_yticks(range(len(conditions)), [plain(name) for name in conditions], fontsize=9)
    panel.tick_params(length=0)
    panel.grid(visible=False)
    panel.spines[:].set_visible(False)
    low, high = panel.get_ylim()
    panel.hlines(np.arange(high + 1, low), -0.5, len(pilots) - 0.5, color='white', linewidth=1)
    panel.vlines(np.arange(0.5, len(pilots) - 1), high, low, color='white', linewidth=1)


def _slanted(pilots: Sequence[str]) -> bool:
    """Return whether names are too many or too long to be written side by side."""
    return len(pilots) > 2 or max(map(len, pilots)) > _LONG
