# SPDX-License-Identifier: Apache-2.0
"""Sparkline: a curve in one line of text."""
from __future__ import annotations

import math
from collections.abc import Sequence

_BLOCKS = '▁▂▃▄▅▆▇█'
_ASCII = '_.-:=+*#'


def resampled(values: Sequence[float], width: int) -> list[float]:
    """Return at most `width` values: means over equal segments of the finite ones."""
    finite = [value for value in values if math.isfinite(value)]
    if len(finite) <= width:
        return finite
    edges = [len(finite) * k // width for k in range(width + 1)]
    return [sum(finite[a:b]) / (b - a) for a, b in zip(edges, edges[1:], strict=False)]


def sparkline(
    values: Sequence[float], width: int, low: float | None = None, high: float | None = None,
    blocks: bool = True,
) -> str:
    """Return a line at most `width` wide, '' when there are no values.

    :param low: value of the lowest mark; by default the minimum.
    :param high: value of the highest mark; by default the maximum.
    :param blocks: draw with Unicode's blocks, else with ASCII.
    """
    marks = _BLOCKS if blocks else _ASCII
    shown = resampled(values, width) if width > 0 else []
    if not shown:
        return ''
    bottom = min(shown) if low is None else low
    span = (max(shown) if high is None else high) - bottom
    if span <= 0:
        return marks[len(marks) // 2] * len(shown)
    top = len(marks) - 1
    return ''.join(
        marks[min(top, max(0, round((value - bottom) / span * top)))] for value in shown)
