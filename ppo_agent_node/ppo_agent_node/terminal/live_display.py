# SPDX-License-Identifier: Apache-2.0
"""Lines at the bottom of a terminal that are redrawn in place, below permanent lines."""
from __future__ import annotations

import os
from collections import deque
from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

_MARGIN = 3
"""Columns left free on the right, where a terminal may echo ^C."""
_REMEMBERED = 100
_HOME, _UP, _CLEAR_LINE, _CLEAR_BELOW = '\x1b[H', '\x1b[{}A', '\x1b[K', '\x1b[J'


class LiveDisplay:
    """The redrawn lines, and the last permanent lines above them.

    When a terminal becomes narrower, some wrap the existing lines and some cut them, and some do
    so before they report the new size: the position of the old display is unknown. rich's own Live
    leaves remains of it; here a new size begins with a cleared screen.
    """

    def __init__(self, console: Console) -> None:
        """Create an empty display."""
        self._console = console
        self._above: deque[Text] = deque(maxlen=_REMEMBERED)
        self._height = 0
        self._drawn_at = self._size()

    @property
    def width(self) -> int:
        """Available columns at the terminal's current size."""
        return max(1, self._size()[0] - _MARGIN)

    def draw(self, lines: Sequence[Text], above: Text | None = None) -> None:
        """Redraw the lines; `above` is written before them and stays.

        :param above: is cut to the width if it has `no_wrap`.
        :raises OSError: when the terminal is gone.
        """
        columns, rows = size = self._size()
        shown = lines[:max(1, rows - 1)]
        fresh = list(above.split('\n')) if above is not None else []
        self._above.extend(fresh)
        if size == self._drawn_at:
            text = '\r' + (_UP.format(self._height - 1) if self._height > 1 else '')
            if fresh:
                text += _CLEAR_BELOW
        else:
            text = _HOME + _CLEAR_BELOW
            fresh = self._last(columns, rows - len(shown) - 1)
        text += ''.join(f'{self._styled(_fitted(line, columns))}\n' for line in fresh)
        text += f'{_CLEAR_LINE}\n'.join(self._styled(line) for line in shown) + _CLEAR_BELOW
        # In one write, so that no partial display is visible.
        self._console.file.write(text)
        self._console.file.flush()
        self._height, self._drawn_at = len(shown), size

    def _last(self, columns: int, rows: int) -> list[Text]:
        """Return the last permanent lines that fit into `rows` rows."""
        chosen: list[Text] = []
        for line in reversed(self._above):
            rows -= max(1, -(-_fitted(line, columns).cell_len // columns))
            if rows < 0:
                break
            chosen.insert(0, line)
        return chosen

    def _size(self) -> tuple[int, int]:
        # rich would query standard output, which may be a pipe while the display is a terminal.
        try:
            columns, lines = os.get_terminal_size(self._console.file.fileno())
        except (OSError, ValueError):
            return self._console.size
        return (columns, lines) if columns and lines else (80, 24)

    def _styled(self, line: Text) -> str:
        with self._console.capture() as capture:
            self._console.print(line, end='', soft_wrap=True)
        return capture.get()


def _fitted(line: Text, columns: int) -> Text:
    if not line.no_wrap:
        return line
    line = line.copy()
    line.truncate(max(1, columns - _MARGIN), overflow='ellipsis')
    return line
