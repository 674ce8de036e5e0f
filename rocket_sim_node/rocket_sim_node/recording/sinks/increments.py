# SPDX-License-Identifier: Apache-2.0
"""A stream that takes a growing flight again and again, and sends only what is new of it."""
from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from typing import cast

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr

FOR_EVER = 2**62


class _Rows:
    """Some rows of a column, of times or of a component."""

    def __init__(self, column: Any, array: pa.Array, mask: pa.Array) -> None:
        """Keep the rows of `array`, the column's, where the mask is true."""
        self._column = column
        self._rows = array.filter(mask)

    def timeline_name(self) -> str:
        """Return the name of the timeline."""
        return str(self._column.timeline_name())

    def component_descriptor(self) -> rr.ComponentDescriptor:
        """Return what the component is."""
        return cast('rr.ComponentDescriptor', self._column.component_descriptor())

    def as_arrow_array(self) -> pa.Array:
        """Return the rows."""
        return self._rows


class Increments:
    """Passes on those rows of an entity that come after all that it has passed of it before.

    Flights lie one after another on the timeline `step`, so for each entity the last step passed
    says what is new, whether a flight goes on or another has begun.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        """Begin with nothing sent."""
        self._stream = stream
        self._last: dict[str, int] = {}
        self.until = FOR_EVER
        """step from which on nothing is passed"""

    def send_columns(
        self, entity_path: str, indexes: Iterable[rr.TimeColumn],
        columns: Iterable[rr.ComponentColumn],
    ) -> None:
        """Pass on what is new, if anything is; see `rerun.send_columns`.

        :raises ValueError: when there is no timeline `step`.
        """
        times = {column.timeline_name(): column for column in indexes}
        if 'step' not in times:
            raise ValueError(f'{entity_path}: timelines {", ".join(times)}, expected step')
        step = np.asarray(times['step'].as_arrow_array())
        new = (step > self._last.get(entity_path, -1)) & (step < self.until)
        if not new.any():
            return
        self._last[entity_path] = int(step[new].max())
        mask = pa.array(new)
        self._stream.send_columns(
            entity_path,
            [_Rows(column, column.as_arrow_array(), mask) for column in times.values()],
            cast('Any', [_Rows(column, column.as_arrow_array(), mask) for column in columns]))
