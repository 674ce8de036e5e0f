# SPDX-License-Identifier: Apache-2.0
"""From samples and training reports to recordings."""
from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Sequence
from typing import Protocol
from typing import TypeAlias

import numpy as np
import rerun as rr

from rocket_sim_node.recording import training_log
from rocket_sim_node.recording.blueprint import blueprint
from rocket_sim_node.recording.choice import Choice
from rocket_sim_node.recording.file_sink import Note
from rocket_sim_node.recording.file_sink import Put
from rocket_sim_node.recording.flight import Flight
from rocket_sim_node.recording.flight import FlightBuffer
from rocket_sim_node.recording.flight import Settling
from rocket_sim_node.recording.flight_log import log_flight
from rocket_sim_node.recording.place import Place
from rocket_sim_node.recording.place import pause_steps
from rocket_sim_node.recording.samples import FLYING
from rocket_sim_node.recording.samples import Samples
from rocket_sim_node.recording.sceneries import scenery
from rocket_sim_node.recording.stage import Stage
from rocket_sim_node.recording.training_log import Training

TRAINING_PERIOD = 10.0
"""s of wall clock for which iterations are gathered before they are logged"""

EARLY = 200
"""messages kept that come before the description of their world"""

Settle: TypeAlias = Callable[[Flight, Stage], Settling | None]
"""Says what becomes of a rocket after a flight, or None where nothing does."""


class Sink(Protocol):
    """Where a recording goes."""

    def begin(self, head: Put, world: str) -> None:
        """Log what stands at the head of a recording of a world."""
        ...

    def write(self, put: Put) -> None:
        """Log something."""
        ...

    def close(self) -> None:
        """Finish."""
        ...


class Recorder:
    """Puts the flights of some rockets one after another on a timeline, with the training beside.

    Flights that overlapped in the simulation are shown in the order in which they ended, with a
    short pause after each; so `sim_time` is the time of the recording.
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
        self._training: Training | None = None
        self._iterations = training_log.IterationCounter()
        self._pending: list[tuple[Place, Training]] = []
        self._pending_since = 0.0
        self._next_step = 0
        self._full: set[bool] = set()
        self.steps = 0
        self.flights = 0

    # What comes in

    def world(self, stage: Stage) -> None:
        """Take note of a world; what came before it was kept for it."""
        known, self._stage = self._stage, stage
        if stage == known:
            return

        def head(stream: rr.RecordingStream) -> None:
            scenery(stage.world).static(stream, stage)
            if self._training is not None:
                _show_training(stream, stage)

        for sink in self._sinks:
            sink.begin(head, stage.world)
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

    def training(self, training: Training) -> None:
        """Take an agent's report."""
        first = self._training is None
        new_stage = first or training.stage != self._training.stage  # type: ignore[union-attr]
        self._training = training
        place = Place(self._next_step, self._iterations.add(training))
        if not self._pending:
            self._pending_since = self._clock()
        if training.learning:
            self._pending.append((place, training))
        dt = self._dt
        stage = self._stage
        if first and stage is not None:  # otherwise the head does it, when the world is known
            self._put(lambda stream: _show_training(stream, stage))
        if new_stage:
            self._put(lambda stream: training_log.log_stage(stream, training.stage, place, dt))
        text = training.message or (f'stage {training.stage}' if new_stage else '')
        if text:
            self._put(lambda stream: training_log.log_text(
                stream, [(place, f'{training.stage}: {text}', 'INFO')], dt))
        self.tick()

    def tick(self) -> None:
        """Log what has waited long enough; call it once a second or so."""
        if self._pending and self._clock() - self._pending_since >= TRAINING_PERIOD:
            self._flush_training()

    def close(self) -> None:
        """Log what is left and finish all recordings.

        A flight that was under way is kept only when no other was recorded.
        """
        if not self.flights:
            for row, buffer in self._buffers.items():
                if len(buffer) > 1:
                    self._record(buffer.finish(row, ''))
                    break
        self._flush_training()
        for sink in self._sinks:
            sink.close()

    # What goes out

    @property
    def _dt(self) -> float:
        return self._stage.dt if self._stage is not None else 0.02

    @property
    def _learning(self) -> bool:
        return self._training is not None and self._training.learning

    def _put(self, put: Put) -> None:
        for sink in self._sinks:
            sink.write(put)

    def _add(self, row: int, buffer: FlightBuffer, samples: Samples) -> None:
        """Take samples of one rocket: the rest of a flight, whole flights, the start of one."""
        assert self._stage is not None
        start = 0
        for end in (np.flatnonzero(samples.outcome != FLYING) + 1).tolist():
            if buffer.extend(samples.take(slice(start, end))):
                flight = buffer.finish(row, self._name(int(samples.outcome[end - 1])))
                landed = flight.outcome == self._stage.outcomes[0]
                if self._choice.wanted(
                        flight.episode, landed=landed, learning=self._learning):
                    self._record(flight)
            start = end
        if start < len(samples.step):
            buffer.extend(samples.take(slice(start, None)))

    def _name(self, outcome: int) -> str:
        assert self._stage is not None
        names = self._stage.outcomes
        return names[outcome] if outcome < len(names) else f'outcome {outcome}'

    def _record(self, flight: Flight) -> None:
        """Log a flight at the end of the recording, if there is room."""
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
            return
        place = Place(self._next_step, self._iterations.count)
        self._put(lambda stream: log_flight(stream, flight, stage, place, settling))
        self.steps += steps
        self.flights += 1
        self._next_step += steps + pause_steps(stage)

    def _flush_training(self) -> None:
        if self._pending:
            rows, self._pending = self._pending, []
            dt = self._dt
            self._put(lambda stream: training_log.log_training(stream, rows, dt))


def _show_training(stream: rr.RecordingStream, stage: Stage) -> None:
    """Add the tab of an agent that trains."""
    training_log.log_styles(stream)
    training_log.log_backdrop(stream, stage)
    stream.send_blueprint(blueprint(training=True, world=stage.world))
