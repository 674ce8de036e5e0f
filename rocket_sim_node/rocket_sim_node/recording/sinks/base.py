# SPDX-License-Identifier: Apache-2.0
"""Where a recording goes."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol
from typing import TypeAlias

import rerun as rr

APPLICATION = 'hoverslam'

Put: TypeAlias = Callable[[rr.RecordingStream], None]
"""Logs something to the stream that it is given, whenever that is."""
Note: TypeAlias = Callable[[str, str], None]
"""Takes a level ('INFO', 'WARN', 'ERROR') and a text."""


@dataclass(frozen=True)
class Look:
    """What decides how a recording is laid out."""

    world: str = ''
    training: bool = False
    unusual: bool = False


class Sink(Protocol):
    """A file, or a viewer that shows what happens while it happens."""

    live: bool
    """Whether it shows flights that are under way."""

    def begin(self, head: Put, look: Look) -> None:
        """Log what stands at the head of a recording, and lay it out."""
        ...

    def write(self, put: Put) -> None:
        """Log something."""
        ...

    def flight(self, put: Put) -> bool:
        """Log a flight that has ended; return whether it was taken."""
        ...

    def under_way(self, put: Put, until: int) -> None:
        """Log what is new of a flight that goes on; sinks that are not live do nothing.

        :param put: logs the flight as if it ended now.
        :param until: step of the recording from which on that is not yet to be shown.
        """
        ...

    def close(self) -> None:
        """Finish."""
        ...
