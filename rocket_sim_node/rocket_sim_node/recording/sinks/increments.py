# SPDX-License-Identifier: Apache-2.0
"""Stream adapter that receives a growing flight repeatedly and forwards only the new rows."""
from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from typing import cast

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr

FOR_EVER = 2**62


class _Rows:
    """Selected rows of a time or component column."""

    def __init__(self, column: Any, array: pa.Array, mask: pa.Array) -> None:
        """Keep the column's rows, given as `array`, where the mask is true."""
        self._column = column
        self._rows = array.filter(mask)

    def timeline_name(self) -> str:
        """Return the name of the timeline."""
        return str(self._column.timeline_name())

    def component_descriptor(self) -> rr.ComponentDescriptor:
        """Return the component's descriptor."""
        return cast('rr.ComponentDescriptor', self._column.component_descriptor())

    def as_arrow_array(self) -> pa.Array:
        """Return the rows."""
        return self._rows


class Increments:
    """Forwards those rows of an entity that come after all that were forwarded before.

    Flights follow one another on the timeline `step`, so for each entity the last forwarded step
    determines what is new, within a flight or in the next one.
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        """Start with nothing sent."""
        self._stream = stream
        self._last: dict[str, int] = {}
        self.until = FOR_EVER
        """Step from which on nothing is forwarded."""

    def send_columns(
        self, entity_path: str, indexes: Iterable[rr.TimeColumn],
        columns: Iterable[rr.ComponentColumn],
    ) -> None:
        """Forward the new rows, if there are any; see `rerun.send_columns`.

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
