# SPDX-License-Identifier: Apache-2.0
"""Selection of the flight that live viewers see in progress."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping

from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer

PERIOD = 0.05
"""Seconds of wall clock between updates of a flight."""
STALLED = 5.0
"""Seconds of wall clock without a new sample before a flight is given up."""
DWELL = 2.0
"""Seconds of wall clock that the end of a flight stays visible before the next is followed."""


class Follower:
    """Follows one flight at a time, from among those that will be recorded.

    Flights of a recording follow one another, and a live view shows the newest. So one flight in
    progress can be shown, and those that end meanwhile wait for its end.
    """

    def __init__(
        self, buffers: Mapping[int, TrajectoryBuffer], clock: Callable[[], float],
    ) -> None:
        """Start without a flight.

        :param buffers: flights in progress, by rocket.
        """
        self._buffers = buffers
        self._clock = clock
        self._due = self._grown = 0.0
        self.flight: Trajectory | None = None
        """The followed flight, as last shown."""

    def follows(self, row: int, episode: int) -> bool:
        """Return whether this flight is followed."""
        flight = self.flight
        return flight is not None and (flight.row, flight.episode) == (row, episode)

    @property
    def busy(self) -> bool:
        """Whether a flight is followed, or the end of one must stay visible."""
        return self.flight is not None or self._clock() < self._due

    @property
    def lost(self) -> bool:
        """Whether the flight was aborted, so that its end will not arrive."""
        flight = self.flight
        return flight is not None and (
            not self._continues(flight) or len(self._buffers[flight.row]) < len(flight))

    @property
    def stalled(self) -> bool:
        """Whether samples have stopped; their source may have died."""
        return self.flight is not None and self._clock() - self._grown >= STALLED

    def _continues(self, flight: Trajectory) -> bool:
        buffer = self._buffers[flight.row]
        return buffer.episode == flight.episode and buffer.first_step == flight.step

    def look(self, wanted: Callable[[int], bool]) -> Trajectory | None:
        """Return the flight up to now, when an update is due.

        :param wanted: returns whether an episode will be recorded, however it ends.
        """
        now = self._clock()
        if now < self._due:
            return None
        if self.flight is None:
            # The newest one, most of which is still to come.
            rows = [row for row, buffer in self._buffers.items()
                    if len(buffer) > 1 and wanted(buffer.episode)]
            if not rows:
                return None
            row = min(rows, key=lambda row: len(self._buffers[row]))
        else:
            row = self.flight.row
        self._due = now + PERIOD
        seen = self._buffers[row].so_far(row)
        if self.flight is None or len(seen) != len(self.flight):
            self._grown = now
        self.flight = seen
        return self.flight

    def end(self) -> None:
        """Stop following the flight; the next one is followed after a moment."""
        self.flight = None
        self._due = self._clock() + DWELL
