# SPDX-License-Identifier: Apache-2.0
"""Which flight live viewers see while it happens."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping

from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer

PERIOD = 0.05
"""s of wall clock between two looks at a flight"""
STALLED = 5.0
"""s of wall clock without a new sample after which a flight is no longer waited for"""
DWELL = 2.0
"""s of wall clock for which the end of a flight is seen before another one is followed"""


class Follower:
    """Follows one flight at a time, from among those that will be recorded.

    A recording has its flights one after another, a live view shows the newest. So one flight
    that is under way can be seen, and what ends meanwhile waits until that one has ended.
    """

    def __init__(
        self, buffers: Mapping[int, TrajectoryBuffer], clock: Callable[[], float],
    ) -> None:
        """Begin with no flight.

        :param buffers: flights that are under way, by rocket.
        """
        self._buffers = buffers
        self._clock = clock
        self._due = self._grown = 0.0
        self.flight: Trajectory | None = None
        """the flight followed, as it was last seen"""

    def follows(self, row: int, episode: int) -> bool:
        """Return whether this flight is the one."""
        flight = self.flight
        return flight is not None and (flight.row, flight.episode) == (row, episode)

    @property
    def busy(self) -> bool:
        """Whether a flight is followed, or the end of one is still to be seen."""
        return self.flight is not None or self._clock() < self._due

    @property
    def lost(self) -> bool:
        """Whether the flight broke off: no end of it will be heard of."""
        flight = self.flight
        return flight is not None and (
            not self._continues(flight) or len(self._buffers[flight.row]) < len(flight))

    @property
    def stalled(self) -> bool:
        """Whether the flight does not go on: who flew it may have died."""
        return self.flight is not None and self._clock() - self._grown >= STALLED

    def _continues(self, flight: Trajectory) -> bool:
        buffer = self._buffers[flight.row]
        return buffer.episode == flight.episode and buffer.first_step == flight.step

    def look(self, wanted: Callable[[int], bool]) -> Trajectory | None:
        """Return the flight as far as it has come, when it is time to show more of it.

        :param wanted: tells of an episode whether it will be recorded, however it ends.
        """
        now = self._clock()
        if now < self._due:
            return None
        if self.flight is None:
            # The youngest, of which there is most to be seen.
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
        """Let go of the flight; the next one is followed after a moment."""
        self.flight = None
        self._due = self._clock() + DWELL
