# SPDX-License-Identifier: Apache-2.0
"""From samples and training reports to recordings."""
from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import rerun as rr

from rocket_sim_node.recording import training_log
from rocket_sim_node.recording.backdrop import BEFORE_FLIGHT
from rocket_sim_node.recording.backdrop import BEFORE_TRAINING
from rocket_sim_node.recording.backdrop import log_backdrop
from rocket_sim_node.recording.choice import Choice
from rocket_sim_node.recording.flight import Flight
from rocket_sim_node.recording.flight import FlightBuffer
from rocket_sim_node.recording.flight import Settling
from rocket_sim_node.recording.flight_log import log_flight
from rocket_sim_node.recording.follower import Follower
from rocket_sim_node.recording.place import Place
from rocket_sim_node.recording.place import pause_steps
from rocket_sim_node.recording.samples import FLYING
from rocket_sim_node.recording.samples import Samples
from rocket_sim_node.recording.sceneries import scenery
from rocket_sim_node.recording.sink import Look
from rocket_sim_node.recording.sink import Note
from rocket_sim_node.recording.sink import Put
from rocket_sim_node.recording.sink import Sink
from rocket_sim_node.recording.stage import Stage
from rocket_sim_node.recording.training_log import Training
from rocket_sim_node.recording.training_recorder import TrainingRecorder

EARLY = 200
"""messages kept that come before the description of their world"""

Settle: TypeAlias = Callable[[Flight, Stage], Settling | None]
"""Says what becomes of a rocket after a flight, or None where nothing does."""


class Recorder:
    """Puts the flights of some rockets one after another on a timeline, with the training beside.

    Flights that overlapped in the simulation are shown in the order in which they ended, with a
    short pause after each; so `sim_time` is the time of the recording. Where a live viewer is
    among the sinks, one flight at a time is shown while it goes on, and those that end meanwhile
    come after it.
    """

    def __init__(
        self, choice: Choice, sinks: Sequence[Sink], note: Note,
        clock: Callable[[], float] = time.monotonic, settle: Settle | None = None,
    ) -> None:
        """Begin an empty recording.

        :param settle: asked after each flight that is recorded while no agent learns; what it
            returns is shown after the flight, before the next one.
        """
        self._choice = choice
        self._sinks = sinks
        self._note = note
        self._clock = clock
        self._settle = settle
        self._buffers = {row: FlightBuffer() for row in choice.rows}
        self._stage: Stage | None = None
        self._session = 0
        self._early: list[tuple[int, Samples]] = []
        self._training: TrainingRecorder | None = None
        self._next_step = 0
        self._full: set[bool] = set()
        self._live = any(sink.live for sink in sinks)
        self._follower = Follower(self._buffers, clock)
        self._held: list[Flight] = []
        self.steps = 0
        self.flights = 0

    # What comes in

    def world(self, stage: Stage) -> None:
        """Take note of a world; what came before it was kept for it."""
        if stage == self._stage:
            return
        self._let_go()
        self._stage = stage
        self._begin(stage)
        early, self._early = self._early, []
        for session, samples in early:
            self.states(session, samples)

    def states(self, session: int, samples: Samples) -> None:
        """Take samples in the order in which they were taken.

        A new session ends all flights that were under way. Samples may overtake the description
        of their world on the wire: they wait for it.
        """
        if self._stage is None:
            self._early = [*self._early[-EARLY:], (session, samples)]
            return
        if session != self._session:
            self._session = session
            for buffer in self._buffers.values():
                buffer.clear()
        for row, buffer in self._buffers.items():
            index = np.flatnonzero(samples.row == row)
            if index.size:
                self._add(row, buffer, samples.take(index))
        if self._live:
            self._show_under_way()

    def training(self, training: Training) -> None:
        """Take an agent's report."""
        if self._training is None:
            self._training = TrainingRecorder(self._put, self._clock)
            if self._stage is not None:  # otherwise it is done when the world is known
                self._begin(self._stage)
        self._training.add(training, self._next_step, self._dt)

    def tick(self) -> None:
        """Log what has waited long enough; call it once a second or so."""
        if self._training is not None:
            self._training.tick(self._dt)

    def close(self) -> None:
        """Log what is left and finish all recordings.

        A flight that was under way is kept only when no other was recorded.
        """
        self._let_go()
        if not self.flights:
            for row, buffer in self._buffers.items():
                if len(buffer) > 1:
                    self._record(buffer.finish(row, ''))
                    break
        if self._training is not None:
            self._training.flush(self._dt)
        for sink in self._sinks:
            sink.close()

    # What goes out

    @property
    def _dt(self) -> float:
        return self._stage.dt if self._stage is not None else 0.02

    @property
    def _learning(self) -> bool:
        return self._training is not None and self._training.learning

    def _begin(self, stage: Stage) -> None:
        """Log what stands at the head of the recording of a world."""
        training = self._training is not None

        def head(stream: rr.RecordingStream) -> None:
            scenery(stage.world).static(stream, stage)
            if training:
                training_log.log_styles(stream)
                log_backdrop(stream, stage, BEFORE_TRAINING)

        def live_head(stream: rr.RecordingStream) -> None:
            head(stream)
            log_backdrop(stream, stage, BEFORE_FLIGHT)

        for sink in self._sinks:
            sink.begin(live_head if sink.live else head, Look(stage.world, training))

    def _put(self, put: Put) -> None:
        for sink in self._sinks:
            sink.write(put)

    def _add(self, row: int, buffer: FlightBuffer, samples: Samples) -> None:
        """Take samples of one rocket: the rest of a flight, whole flights, the start of one."""
        assert self._stage is not None
        start = 0
        for end in (np.flatnonzero(samples.outcome != FLYING) + 1).tolist():
            if buffer.extend(samples.take(slice(start, end))):
                self._finish(buffer.finish(row, self._name(int(samples.outcome[end - 1]))))
            start = end
        if start < len(samples.step):
            buffer.extend(samples.take(slice(start, None)))

    def _name(self, outcome: int) -> str:
        assert self._stage is not None
        names = self._stage.outcomes
        return names[outcome] if outcome < len(names) else f'outcome {outcome}'

    def _finish(self, flight: Flight) -> None:
        """Record a flight that has ended, if it is wanted; now, or after the one followed."""
        assert self._stage is not None
        followed = self._follower.follows(flight.row, flight.episode)
        landed = flight.outcome == self._stage.outcomes[0]
        if not followed and not self._choice.wanted(
                flight.episode, landed=landed, learning=self._learning):
            return
        if self._follower.flight is not None and not followed:
            self._held.append(flight)
            return
        if not self._record(flight) and followed:
            self._let_go()
        elif followed:
            self._follower.end()
        self._record_held()

    def _record_held(self) -> None:
        held, self._held = self._held, []
        for flight in held:
            self._record(flight)

    def _record(self, flight: Flight) -> bool:
        """Log a flight at the end of the recording; return whether there was room."""
        stage = self._stage
        assert stage is not None
        room = self._choice.room(learning=self._learning) - self.steps
        steps, settling = len(flight), None
        # Of a flight that is not recorded nobody need know what became of it.
        if self._settle is not None and not self._learning and steps <= room:
            settling = self._settle(flight, stage)
            steps += len(settling.values) if settling is not None else 0
        if steps > room:
            if self._learning not in self._full:
                self._full.add(self._learning)
                self._note('WARN', (
                    f'max_steps: {self.steps} steps are recorded, no more flights'
                    + (' until the agent has learnt' if self._learning else '')))
            return False
        put = self._put_of(flight, settling)
        for sink in self._sinks:
            sink.flight(put)
        self.steps += steps
        self.flights += 1
        self._next_step += steps + pause_steps(stage)
        return True

    def _put_of(self, flight: Flight, settling: Settling | None = None) -> Put:
        """Return what logs a flight at the end of the recording."""
        stage = self._stage
        assert stage is not None
        iteration = self._training.iteration if self._training is not None else 0
        place = Place(self._next_step, iteration)
        return lambda stream: log_flight(stream, flight, stage, place, settling)

    # What is seen while it happens

    def _show_under_way(self) -> None:
        """Show more of the flight that is followed, or begin to follow one."""
        if self._follower.lost:
            self._let_go()
        room = self._choice.room(learning=self._learning) - self.steps

        def wanted(episode: int) -> bool:
            # Landed or not is not known yet: only what is recorded in either case.
            return room > 0 and self._choice.wanted(
                episode, landed=True, learning=self._learning)

        flight = self._follower.look(wanted)
        if flight is not None:
            put = self._put_of(flight)
            # Its last sample may be drawn otherwise when there are more.
            until = self._next_step + len(flight) - 1
            for sink in self._sinks:
                sink.under_way(put, until)

    def _let_go(self) -> None:
        """Leave a flight unfinished that was followed; what waited for its end is recorded."""
        flight = self._follower.flight
        if flight is not None and self._stage is not None:
            put = self._put_of(flight)
            end = self._next_step + len(flight) + pause_steps(self._stage)
            for sink in self._sinks:
                sink.under_way(put, end)
            self._next_step = end
            self._follower.end()
        self._record_held()
