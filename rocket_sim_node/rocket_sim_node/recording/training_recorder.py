# SPDX-License-Identifier: Apache-2.0
"""An agent's reports on their way into a recording."""
from __future__ import annotations

from collections.abc import Callable

from rocket_sim_node.recording import training_log
from rocket_sim_node.recording.place import Place
from rocket_sim_node.recording.sink import Put
from rocket_sim_node.recording.training_log import Training

PERIOD = 10.0
"""s of wall clock for which iterations are gathered before they are logged"""


class TrainingRecorder:
    """Gathers iterations and logs them together, stages and messages at once."""

    def __init__(self, put: Callable[[Put], None], clock: Callable[[], float]) -> None:
        """Begin before the first report.

        :param put: logs something.
        """
        self._put = put
        self._clock = clock
        self._iterations = training_log.IterationCounter()
        self._pending: list[tuple[Place, Training]] = []
        self._pending_since = 0.0
        self._stage = ''

    @property
    def iteration(self) -> int:
        """The number of the run's iteration, counted through all stages."""
        return self._iterations.count

    def news(self, training: Training) -> bool:
        """Tell whether a report begins a stage or has something to say."""
        return training.stage != self._stage or bool(training.message)

    def add(self, training: Training, step: int, dt: float) -> None:
        """Take a report that came at a step of the recording.

        :param dt: s, of a step.
        """
        new_stage = training.stage != self._stage
        self._stage = training.stage
        place = Place(step, self._iterations.add(training))
        if not self._pending:
            self._pending_since = self._clock()
        if training.learning:
            self._pending.append((place, training))
        if new_stage:
            self._put(lambda stream: training_log.log_stage(stream, training.stage, place, dt))
        text = training.message or (f'stage {training.stage}' if new_stage else '')
        if text:
            self._put(lambda stream: training_log.log_text(
                stream, [(place, f'{training.stage}: {text}', 'INFO')], dt))
        self.tick(dt)

    def tick(self, dt: float) -> None:
        """Log what has waited long enough."""
        if self._pending and self._clock() - self._pending_since >= PERIOD:
            self.flush(dt)

    def flush(self, dt: float) -> None:
        """Log what waits."""
        if self._pending:
            rows, self._pending = self._pending, []
            self._put(lambda stream: training_log.log_training(stream, rows, dt))
