# SPDX-License-Identifier: Apache-2.0
"""Interface of the destinations of a recording."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol
from typing import TypeAlias

import rerun as rr

APPLICATION = 'hoverslam'

Put: TypeAlias = Callable[[rr.RecordingStream], None]
"""Function that logs something to the given stream, possibly later and repeatedly."""


@dataclass(frozen=True)
class Look:
    """Properties of a recording that determine its layout."""

    world: str = ''
    training: bool = False
    unusual: bool = False


class Sink(Protocol):
    """A file, or a live viewer."""

    live: bool
    """Whether it shows flights in progress."""

    def begin(self, head: Put, look: Look) -> None:
        """Log the start of a recording, and its layout."""
        ...

    def write(self, put: Put) -> None:
        """Log something."""
        ...

    def write_trajectory(self, put: Put) -> bool:
        """Log an ended flight; return whether it was accepted."""
        ...

    def under_way(self, put: Put, until: int) -> None:
        """Log the new part of a flight in progress; sinks that are not live do nothing.

        :param put: logs the flight as if it ended now.
        :param until: step of the recording from which on nothing is to be shown yet.
        """
        ...

    def close(self) -> None:
        """Finish."""
        ...
