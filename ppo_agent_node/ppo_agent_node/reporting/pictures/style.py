# SPDX-License-Identifier: Apache-2.0
"""Common style of all pictures: palette, fonts and saving."""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from matplotlib.ticker import MaxNLocator
from matplotlib.ticker import NullLocator
from matplotlib.ticker import StrMethodFormatter
from numpy.typing import NDArray

from ppo_agent_node.atomic_file import write_atomically
from rocket_sim_node import palette

Values = NDArray[np.float64] | NDArray[np.int64]
Chosen = NDArray[np.bool_]

# Okabe and Ito, 'Color universal design', 2008: distinguishable with colour blindness.
BLUE, ORANGE, GREEN, VERMILION, SKY, PURPLE, YELLOW = (
    '#0072B2', '#E69F00', '#009E73', '#D55E00', '#56B4E9', '#CC79A7', '#F0E442')
INK, GREY, PALE = '#333333', '#BBBBBB', '#F4F4F4'
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, INK, YELLOW)
"""Colours of groups, in order; the pale ones last."""

_STYLE: dict[Any, Any] = {
    'font.size': 10.5, 'axes.titlesize': 12, 'axes.titlelocation': 'left',
    'axes.titleweight': 'bold', 'axes.spines.top': False, 'axes.spines.right': False,
    'axes.edgecolor': INK, 'axes.labelcolor': INK, 'text.color': INK, 'xtick.color': INK,
    'ytick.color': INK, 'axes.grid': True, 'grid.color': '#E6E6E6', 'axes.axisbelow': True,
    'legend.frameon': False, 'savefig.dpi': 150, 'axes.titlepad': 12,
    'figure.titleweight': 'bold', 'figure.titlesize': 12, 'figure.constrained_layout.use': True,
}


@contextmanager
def styled() -> Iterator[None]:
    """Use the project's plotting style within the context, regardless of the user's settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def plain_logarithm(axis: Axis) -> None:
    """Label 1, 2 and 5 of each decade of a logarithmic axis with plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter('{x:,.10g}'))
    axis.set_minor_locator(NullLocator())


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG and return the path.

    :raises OSError: naming the path; an earlier file is unchanged.
    """
    figure.set_dpi(mpl.rcParams['savefig.dpi'])
    data = BytesIO()
    # savefig would lay it out twice.
    FigureCanvasAgg(figure).print_png(data)  # type: ignore[no-untyped-call]
    write_atomically(path, data.getvalue())
    return path


def outcome_colours(outcomes: Sequence[str]) -> dict[str, str]:
    """Return the colour of each outcome, the same as in recordings: green is landed."""
    colours = palette.outcome_colours(tuple(outcomes))
    return {name: '#{:02X}{:02X}{:02X}'.format(*colour) for name, colour in colours.items()}


def plain(text: str) -> str:
    """Return a text from a file, escaped so that it is not drawn as a formula."""
    return text.replace('$', r'\$')


def thin(chosen: Chosen, most: int = 20_000) -> NDArray[np.intp]:
    """Return the indices of selected entries, evenly thinned to `most` visible ones."""
    places = np.flatnonzero(chosen)
    return places if len(places) <= most else places[
        np.linspace(0, len(places) - 1, most).astype(np.intp)]


def whole_ticks(axes: Axes) -> None:
    """Put ticks along x at integers only."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
