# SPDX-License-Identifier: Apache-2.0
"""Recorder: turns samples and training reports into recordings."""
from __future__ import annotations

import math
import operator
import time
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np

from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.header import head
from rocket_sim_node.recording.scene.conditions_log import unusual
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.sinks.base import Look
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.sinks.base import Sink
from rocket_sim_node.recording.sinks.destinations import Note
from rocket_sim_node.recording.timeline import Settle
from rocket_sim_node.recording.timeline import Timeline
from rocket_sim_node.recording.training_recorder import TrainingRecorder
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.follower import Follower
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.gaps import GapCounter
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import Samples

EARLY = 200
"""Maximum messages kept that arrive before the description of their world."""
MOST_HELD = 16
"""Number of flights after which waiting ones are recorded."""
HELD = 5.0
"""Seconds that flights wait for others to be recorded together, without live viewers."""
GAPS_APART = 1.0
"""Minimum time, s, between two warnings of steps that were not received."""


class Recorder:
    """Puts rockets' flights one after another on a timeline, along with the training.

    Flights that overlapped in the simulation are shown in the order in which they ended, with a
    short pause after each, so `sim_time` is the recording's own time. With a live viewer among the
    sinks, one flight at a time is shown while in progress, and those that end meanwhile follow it.
    Without one, and while no agent learns, flights wait some seconds so that several can be
    settled together.
    """

    def __init__(
        self, selection: RecordingFilter, sinks: Sequence[Sink], note: Note,
        clock: Callable[[], float] = time.monotonic, settle: Settle | None = None,
    ) -> None:
        """Create an empty recording.

        :param settle: called for flights that are recorded while no agent learns; the motion that
            it returns is shown after each of them, before the next one.
        """
        self._selection = selection
        self._sinks = sinks
        self._clock = clock
        self._buffers = {row: TrajectoryBuffer() for row in selection.rows}
        self._world: WorldInfo | None = None
        self._session = 0
        self._gaps = GapCounter()
        self._note = note
        self._gap_told = -math.inf
        self._over = False
        self._early: list[tuple[int, Samples]] = []
        self._unusual = False
        self._training: TrainingRecorder | None = None
        self._timeline = Timeline(selection, sinks, note, settle)
        self._live = any(sink.live for sink in sinks)
        self._follower = Follower(self._buffers, clock)
        self._held: list[Trajectory] = []
        self._held_since = 0.0

    @property
    def steps(self) -> int:
        """Steps recorded."""
        return self._timeline.steps

    @property
    def flights(self) -> int:
        """Flights recorded."""
        return self._timeline.flights

    @property
    def missed(self) -> int:
        """Steps not received; a simulator that knows no subscriber does not publish them."""
        return self._gaps.missed

    # Input

    def world(self, info: WorldInfo) -> None:
        """Set the world, and process samples that arrived before its description."""
        if info == self._world:
            return
        try:
            self._finish_all()
        finally:  # even if flights of the previous world cannot be shown
            self._world = info
            self._begin(info)
        early, self._early = self._early, []
        for session, samples in early:
            self.states(session, samples)

    def states(self, session: int, samples: Samples) -> None:
        """Add samples in the order in which they were taken.

        A new session ends all flights in progress. So do steps that were not received, of which a
        warning tells. Samples may arrive before the description of their world; they are kept
        until then.

        :raises ValueError: when their legs or conditions are not those of their world.
        """
        if self._world is None:
            if len(self._early) == EARLY:
                del self._early[0]
                self._warn(f'state: more than {EARLY} messages arrived before the description on '
                           'topic world: the oldest are ignored')
            self._early.append((session, samples))
            return
        legs = scenery(self._world.world).legs
        if legs and samples.layout.legs != legs:
            raise ValueError(f'contact: for {samples.layout.legs} legs, expected {legs}, as world '
                             f'{self._world.world!r} has')
        if not self._unusual and unusual(samples.values, samples.layout, self._world):
            self._unusual = True
            self._begin(self._world)
        if session != self._session:
            self._let_go()
            self._session = session
            for buffer in self._buffers.values():
                buffer.clear()
        if len(samples.step):
            first, last = int(samples.step[0]), int(samples.step[-1])
            if missing := self._gaps.note(session, first, last):
                self._warn(f'state: {missing} steps before step {first} were not received: '
                           'flights in progress are not recorded')
        ended: list[tuple[int, Trajectory]] = []
        for row, buffer in self._buffers.items():
            index = np.flatnonzero(samples.row == row)
            if index.size:
                ended += self._add(row, buffer, samples.take(index))
        for _, flight in sorted(ended, key=operator.itemgetter(0)):
            self._finish(flight)
        if self._live:
            self._show_under_way()

    def training(self, training: Training) -> None:
        """Add an agent's report."""
        if self._training is None:
            self._training = TrainingRecorder(self._put, self._clock)
            if self._world is not None:  # otherwise done when the world is known
                self._begin(self._world)
        if training.learning != self._timeline.learning:
            self._finish_all()
        elif self._training.news(training):
            self._record_held(now=True)  # they were flown before this report
        self._training.add(training, self._timeline.end, self._dt)
        self._timeline.learning = training.learning
        self._timeline.iteration = self._training.iteration

    def training_is_over(self) -> None:
        """Note that there is no agent left to report."""
        if self._timeline.learning:
            self._finish_all()
            self._timeline.learning = False

    def tick(self) -> None:
        """Log data that has waited long enough; call it about once a second."""
        if self._training is not None:
            self._training.tick(self._dt)
        if self._follower.stalled:
            self._let_go()
        self._record_held()

    def close(self) -> None:
        """Log what is left and finish all recordings.

        A flight in progress is kept only if no other was recorded.
        """
        with ExitStack() as stack:
            for sink in self._sinks:
                stack.callback(sink.close)
            self.log_the_rest()

    def log_the_rest(self) -> None:
        """Log what is left, once; nothing may be added afterwards."""
        if self._over:
            return
        self._over = True
        followed = self._follower.flight
        if self._world is not None and not self.flights and not self._held:
            rows = [row for row, buffer in self._buffers.items() if len(buffer) > 1]
            if rows:
                row = followed.row if followed is not None and followed.row in rows else rows[0]
                self._timeline.record([self._buffers[row].finish(row, '')], self._world)
                self._follower.end()
        self._finish_all()
        if self._training is not None:
            self._training.flush(self._dt)

    def _warn(self, text: str) -> None:
        """Warn of lost samples, unless it was done just now."""
        if (now := self._clock()) - self._gap_told >= GAPS_APART:
            self._gap_told = now
            self._note('WARN', text)

    # Recording

    @property
    def _dt(self) -> float:
        return self._world.dt if self._world is not None else 0.02

    def _begin(self, info: WorldInfo) -> None:
        """Log the start of a world's recording."""
        look = Look(info.world, self._training is not None, self._unusual)
        for sink in self._sinks:
            sink.begin(head(info, look, sink.live), look)

    def _put(self, put: Put) -> None:
        for sink in self._sinks:
            sink.write(put)

    def _add(
        self, row: int, buffer: TrajectoryBuffer, samples: Samples,
    ) -> Iterator[tuple[int, Trajectory]]:
        """Add samples of one rocket: the rest of a flight, whole flights, the start of one.

        :return: flights that ended, each with its last step.
        """
        start = 0
        for end in (np.flatnonzero(samples.outcome != NO_OUTCOME) + 1).tolist():
            if buffer.extend(samples.take(slice(start, end))):
                name = self._name(int(samples.outcome[end - 1]))
                yield int(samples.step[end - 1]), buffer.finish(row, name)
            start = end
        if start < len(samples.step):
            buffer.extend(samples.take(slice(start, None)))

    def _name(self, outcome: int) -> str:
        assert self._world is not None
        names = self._world.outcomes
        return names[outcome] if outcome < len(names) else f'outcome {outcome}'

    def _finish(self, flight: Trajectory) -> None:
        """Record an ended flight, if it is wanted: now, or after the followed one."""
        assert self._world is not None
        followed = self._follower.follows(flight.row, flight.episode)
        landed = flight.outcome == self._world.outcomes[0]
        if not followed and not self._selection.wanted(
                flight.episode, landed=landed, learning=self._timeline.learning):
            return
        waits = self._follower.busy if self._live else self._timeline.settles
        if waits and not followed:
            if not self._held:
                self._held_since = self._clock()
            self._held.append(flight)
            self._record_held()
            return
        taken = self._timeline.record([flight], self._world)
        if followed and taken:
            self._follower.end()
        elif followed:
            self._let_go()

    def _finish_all(self) -> None:
        """Stop following the current flight, and record all waiting ones."""
        self._let_go()
        self._record_held(now=True)

    def _record_held(self, now: bool = False) -> None:
        """Record flights that have waited long enough.

        They wait until the followed flight has been shown, however many they are; without a
        viewer, for HELD seconds and at most MOST_HELD of them.

        :param now: do not wait, unless a flight is followed.
        """
        if not self._held or self._follower.flight is not None:
            return
        many = len(self._held) > MOST_HELD
        due = (not self._follower.busy if self._live
               else self._clock() - self._held_since >= HELD)
        if now or many or due:
            assert self._world is not None
            held, self._held = self._held, []
            self._timeline.record(held, self._world)

    # Live view

    def _show_under_way(self) -> None:
        """Show more of the followed flight, or begin to follow one."""
        assert self._world is not None
        if self._follower.lost:
            self._let_go()
        self._record_held()
        flight = self._follower.look(self._sure)
        if flight is not None:
            self._timeline.show(flight, self._world)

    def _sure(self, episode: int) -> bool:
        """Return whether a flight will be recorded, however it ends."""
        return self._timeline.open and self._selection.wanted(
            episode, landed=True, learning=self._timeline.learning)

    def _let_go(self) -> None:
        """Stop following a flight before its end; record the flights that waited for it."""
        flight = self._follower.flight
        if flight is not None and self._world is not None:
            self._timeline.leave(flight, self._world)
            self._follower.end()
            self._record_held(now=True)
