# SPDX-License-Identifier: Apache-2.0
"""Timeline of a recording, on which flights follow one another."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from typing import TypeAlias

from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.sinks.base import Sink
from rocket_sim_node.recording.sinks.destinations import Note
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.trajectory import Settling
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.recording.trajectory_log import log_flight

Settle: TypeAlias = Callable[[Sequence[Trajectory], WorldInfo], list[Settling | None]]
"""Function that returns the motion of each rocket after its flight, or None."""


class Timeline:
    """Position of the end of the recording, and its remaining capacity.

    `learning` is whether an agent learns, `iteration` that of its run, if one has reported.
    """

    def __init__(
        self, selection: RecordingFilter, sinks: Sequence[Sink], note: Note, settle: Settle | None,
    ) -> None:
        """Start empty."""
        self._selection = selection
        self._sinks = sinks
        self._note = note
        self._settle = settle
        self._full: set[bool] = set()
        self.learning = False
        self.iteration: int | None = None
        self.end = 0
        """Step at which the next flight begins."""
        self.steps = 0
        self.flights = 0

    @property
    def open(self) -> bool:
        """Whether viewers still see new flights."""
        return not (self.learning and True in self._full)

    @property
    def settles(self) -> bool:
        """Whether flights are followed beyond touchdown."""
        return self._settle is not None and not self.learning

    def record(self, flights: Sequence[Trajectory], info: WorldInfo) -> bool:
        """Log flights at the end, one after another; return whether all of them were accepted.

        When the recording is full, live viewers still see new flights, unless an agent learns.
        """
        settlings: Sequence[Settling | None] = [None] * len(flights)
        # Flights that are not shown need no settling.
        if self.settles and (self._shown or self._room > 0):
            assert self._settle is not None
            try:
                settlings = self._settle(flights, info)
            except ValueError as error:
                self._note('WARN', f'{len(flights)} flights are shown without their motion after '
                                   f'touchdown: {error}')
        taken = [
            self._record(flight, info, settling)
            for flight, settling in zip(flights, settlings, strict=True)]
        return all(taken)

    @property
    def _room(self) -> int:
        """Number of steps that may still be recorded."""
        if self.learning in self._full:
            return 0
        return self._selection.room(learning=self.learning) - self.steps

    @property
    def _shown(self) -> bool:
        """Whether viewers see flights that are not recorded."""
        return not self.learning and any(sink.live for sink in self._sinks)

    def _record(self, flight: Trajectory, info: WorldInfo, settling: Settling | None) -> bool:
        learning = self.learning
        steps = len(flight) + (len(settling.values) if settling is not None else 0)
        fits = steps <= self._room
        if not fits and learning not in self._full:
            self._full.add(learning)
            self._note('WARN', (
                f'max_steps: {self.steps} steps are recorded; no more flights are recorded'
                + (' until training ends' if learning else '')))
        if not fits and not self._shown:
            return False
        put = self._put_of(flight, info, settling)
        taken = [(sink, sink.write_trajectory(put)) for sink in self._sinks if fits or sink.live]
        # A file may have been closed early; if there is one, flights seen only live do not count.
        files = [took for sink, took in taken if not sink.live]
        if fits and (any(files) or not files):
            self.steps += steps
            self.flights += 1
        self.end += steps + pause_steps(info)
        return True

    def show(self, flight: Trajectory, info: WorldInfo) -> None:
        """Show the present part of a flight in progress live."""
        # Without its last sample, whose drawing may depend on later ones.
        self._show(flight, info, self.end + len(flight) - 1)

    def leave(self, flight: Trajectory, info: WorldInfo) -> None:
        """Show live that a flight was aborted; the next one begins after it."""
        end = self.end + len(flight) + pause_steps(info)
        self._show(flight, info, end)
        self.end = end

    def _show(self, flight: Trajectory, info: WorldInfo, until: int) -> None:
        put = self._put_of(flight, info)
        for sink in self._sinks:
            sink.under_way(put, until)

    def _put_of(
        self, flight: Trajectory, info: WorldInfo, settling: Settling | None = None,
    ) -> Put:
        at = Timepoint(self.end, self.iteration)
        return lambda stream: log_flight(stream, flight, info, at, settling)
