# SPDX-License-Identifier: Apache-2.0
"""From samples and training reports to recordings."""
from __future__ import annotations

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
from rocket_sim_node.recording.sinks.base import Note
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.sinks.base import Sink
from rocket_sim_node.recording.timeline import Settle
from rocket_sim_node.recording.timeline import Timeline
from rocket_sim_node.recording.training_recorder import TrainingRecorder
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.follower import Follower
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.samples import FLYING
from rocket_sim_node.telemetry.samples import Samples

EARLY = 200
"""messages kept that come before the description of their world"""
MOST_HELD = 16
"""flights that wait to be recorded together"""
HELD = 5.0
"""s that flights wait for others, where nobody watches"""


class Recorder:
    """Puts the flights of some rockets one after another on a timeline, with the training beside.

    Flights that overlapped in the simulation are shown in the order in which they ended, with a
    short pause after each; so `sim_time` is the time of the recording. Where a live viewer is
    among the sinks, one flight at a time is shown while it goes on, and those that end meanwhile
    come after it. Where none is and no agent learns, flights wait some seconds for others with
    which they settle.
    """

    def __init__(
        self, choice: RecordingFilter, sinks: Sequence[Sink], note: Note,
        clock: Callable[[], float] = time.monotonic, settle: Settle | None = None,
    ) -> None:
        """Begin an empty recording.

        :param settle: asked after flights that are recorded while no agent learns; what it
            returns is shown after each of them, before the next one.
        """
        self._choice = choice
        self._sinks = sinks
        self._clock = clock
        self._buffers = {row: TrajectoryBuffer() for row in choice.rows}
        self._stage: WorldInfo | None = None
        self._session = 0
        self._over = False
        self._early: list[tuple[int, Samples]] = []
        self._unusual = False
        self._training: TrainingRecorder | None = None
        self._reel = Timeline(choice, sinks, note, settle)
        self._live = any(sink.live for sink in sinks)
        self._follower = Follower(self._buffers, clock)
        self._held: list[Trajectory] = []
        self._held_since = 0.0

    @property
    def steps(self) -> int:
        """Steps recorded."""
        return self._reel.steps

    @property
    def flights(self) -> int:
        """Flights recorded."""
        return self._reel.flights

    # What comes in

    def world(self, stage: WorldInfo) -> None:
        """Take note of a world; what came before it was kept for it."""
        if stage == self._stage:
            return
        try:
            self._finish_all()
        finally:  # be it that the flights of the world before cannot be shown
            self._stage = stage
            self._begin(stage)
        early, self._early = self._early, []
        for session, samples in early:
            self.states(session, samples)

    def states(self, session: int, samples: Samples) -> None:
        """Take samples in the order in which they were taken.

        A new session ends all flights that were under way. Samples may overtake the description
        of their world on the wire: they wait for it.

        :raises ValueError: when they have not the legs or conditions that their world has.
        """
        if self._stage is None:
            self._early = [*self._early, (session, samples)][-EARLY:]
            return
        legs = scenery(self._stage.world).legs
        if legs and samples.layout.legs != legs:
            raise ValueError(f'contact: for {samples.layout.legs} legs, expected {legs}, as world '
                             f'{self._stage.world!r} has')
        if not self._unusual and unusual(samples.values, samples.layout, self._stage):
            self._unusual = True
            self._begin(self._stage)
        if session != self._session:
            self._let_go()
            self._session = session
            for buffer in self._buffers.values():
                buffer.clear()
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
        """Take an agent's report."""
        if self._training is None:
            self._training = TrainingRecorder(self._put, self._clock)
            if self._stage is not None:  # otherwise it is done when the world is known
                self._begin(self._stage)
        if training.learning != self._reel.learning:
            self._finish_all()
        elif self._training.news(training):
            self._record_held(now=True)  # which were flown before it
        self._training.add(training, self._reel.end, self._dt)
        self._reel.learning = training.learning
        self._reel.iteration = self._training.iteration

    def training_is_over(self) -> None:
        """Take note that no agent is there any more that might report."""
        if self._reel.learning:
            self._finish_all()
            self._reel.learning = False

    def tick(self) -> None:
        """Log what has waited long enough; call it once a second or so."""
        if self._training is not None:
            self._training.tick(self._dt)
        if self._follower.stalled:
            self._let_go()
        self._record_held()

    def close(self) -> None:
        """Log what is left and finish all recordings.

        A flight that was under way is kept only when no other was recorded.
        """
        with ExitStack() as stack:
            for sink in self._sinks:
                stack.callback(sink.close)
            self.log_the_rest()

    def log_the_rest(self) -> None:
        """Log what is left, once; nothing is to come after that."""
        if self._over:
            return
        self._over = True
        followed = self._follower.flight
        if self._stage is not None and not self.flights and not self._held:
            rows = [row for row, buffer in self._buffers.items() if len(buffer) > 1]
            if rows:
                row = followed.row if followed is not None and followed.row in rows else rows[0]
                self._reel.record([self._buffers[row].finish(row, '')], self._stage)
                self._follower.end()
        self._finish_all()
        if self._training is not None:
            self._training.flush(self._dt)

    # What becomes of it

    @property
    def _dt(self) -> float:
        return self._stage.dt if self._stage is not None else 0.02

    def _begin(self, stage: WorldInfo) -> None:
        """Log what stands at the head of the recording of a world."""
        look = Look(stage.world, self._training is not None, self._unusual)
        for sink in self._sinks:
            sink.begin(head(stage, look, sink.live), look)

    def _put(self, put: Put) -> None:
        for sink in self._sinks:
            sink.write(put)

    def _add(
        self, row: int, buffer: TrajectoryBuffer, samples: Samples,
    ) -> Iterator[tuple[int, Trajectory]]:
        """Take samples of one rocket: the rest of a flight, whole flights, the start of one.

        :return: flights that ended, each with its last step.
        """
        start = 0
        for end in (np.flatnonzero(samples.outcome != FLYING) + 1).tolist():
            if buffer.extend(samples.take(slice(start, end))):
                name = self._name(int(samples.outcome[end - 1]))
                yield int(samples.step[end - 1]), buffer.finish(row, name)
            start = end
        if start < len(samples.step):
            buffer.extend(samples.take(slice(start, None)))

    def _name(self, outcome: int) -> str:
        assert self._stage is not None
        names = self._stage.outcomes
        return names[outcome] if outcome < len(names) else f'outcome {outcome}'

    def _finish(self, flight: Trajectory) -> None:
        """Record a flight that has ended, if it is wanted; now, or after the one followed."""
        assert self._stage is not None
        followed = self._follower.follows(flight.row, flight.episode)
        landed = flight.outcome == self._stage.outcomes[0]
        if not followed and not self._choice.wanted(
                flight.episode, landed=landed, learning=self._reel.learning):
            return
        waits = self._follower.busy if self._live else self._reel.settles
        if waits and not followed:
            if not self._held:
                self._held_since = self._clock()
            self._held.append(flight)
            self._record_held()
            return
        taken = self._reel.record([flight], self._stage)
        if followed and taken:
            self._follower.end()
        elif followed:
            self._let_go()

    def _finish_all(self) -> None:
        """Leave the flight that is followed, record those that wait: others are to come."""
        self._let_go()
        self._record_held(now=True)

    def _record_held(self, now: bool = False) -> None:
        """Record flights that waited long enough.

        That is until there is nothing more to be seen of the one followed; or, where there is no
        viewer, for HELD. MOST_HELD is enough in either case.

        :param now: be that as it may; not while one is followed.
        """
        if not self._held or self._follower.flight is not None:
            return
        many = len(self._held) > MOST_HELD
        due = (not self._follower.busy if self._live
               else self._clock() - self._held_since >= HELD)
        if now or many or due:
            assert self._stage is not None
            held, self._held = self._held, []
            self._reel.record(held, self._stage)

    # What is seen while it happens

    def _show_under_way(self) -> None:
        """Show more of the flight that is followed, or begin to follow one."""
        assert self._stage is not None
        if self._follower.lost:
            self._let_go()
        self._record_held()
        flight = self._follower.look(self._sure)
        if flight is not None:
            self._reel.show(flight, self._stage)

    def _sure(self, episode: int) -> bool:
        """Tell whether a flight will be shown in the end, however it ends."""
        return self._reel.open and self._choice.wanted(
            episode, landed=True, learning=self._reel.learning)

    def _let_go(self) -> None:
        """Leave a flight unfinished that was followed; what waited for its end is recorded."""
        flight = self._follower.flight
        if flight is not None and self._stage is not None:
            self._reel.leave(flight, self._stage)
            self._follower.end()
            self._record_held(now=True)
