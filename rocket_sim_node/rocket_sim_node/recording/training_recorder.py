# SPDX-License-Identifier: Apache-2.0
"""Buffering and logging of an agent's training reports."""
from __future__ import annotations

from collections.abc import Callable

from rocket_sim_node.recording.drawing import training_plots
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.sinks.base import Put

PERIOD, LONGEST_PERIOD = 10.0, 120.0
"""Initial and maximum buffering period of reports, s of wall clock."""
PERIOD_SHARE = 1 / 60
"""Buffering period as a fraction of the training time so far, if that is longer."""
MOST_GATHERED = 500
"""Maximum number of buffered reports: enough for a chunk, and little memory."""


class TrainingRecorder:
    """Buffers an agent's reports and logs them together; at once when a stage begins.

    Each logging adds chunks to the recording, and each chunk some 2 KiB to its table of contents.
    So the buffering period grows with the length of the training.
    """

    def __init__(self, put: Callable[[Put], None], clock: Callable[[], float]) -> None:
        """Start before the first report.

        :param put: logs something.
        """
        self._put = put
        self._clock = clock
        self._iterations = training_plots.IterationCounter()
        self._pending = training_plots.GatheredReports()
        self._texts: list[tuple[Timepoint, str, str]] = []
        self._began = self._pending_since = clock()
        self._stage = ''

    @property
    def iteration(self) -> int:
        """The run's iteration, counted through all stages."""
        return self._iterations.count

    def news(self, training: Training) -> bool:
        """Return whether a report begins a stage or has a message."""
        return training.stage != self._stage or bool(training.message)

    def add(self, training: Training, step: int, dt: float) -> None:
        """Add a report that was received at a step of the recording.

        :param dt: s, of a step.
        """
        new_stage = training.stage != self._stage
        self._stage = training.stage
        at = Timepoint(step, self._iterations.add(training))
        if not self._pending and not self._texts:
            self._pending_since = self._clock()
        if training.learning:
            self._pending.add(at, training.values)
        if new_stage:
            self._put(lambda stream: training_plots.log_stage(stream, training.stage, at, dt))
        text = training.message or (f'stage {training.stage}' if new_stage else '')
        if text:
            self._texts.append((at, f'{training.stage}: {text}', 'INFO'))
        if text and (new_stage or not training.learning):
            self.flush(dt)
        self.tick(dt)

    def tick(self, dt: float) -> None:
        """Log reports that have waited long enough."""
        if not self._pending and not self._texts:
            return
        now = self._clock()
        period = min(max(PERIOD, PERIOD_SHARE * (now - self._began)), LONGEST_PERIOD)
        if now - self._pending_since >= period or len(self._pending) >= MOST_GATHERED:
            self.flush(dt)

    def flush(self, dt: float) -> None:
        """Log all buffered reports."""
        if self._pending:
            places, values = self._pending.take()
            self._put(lambda stream: training_plots.log_training(stream, places, values, dt))
        if self._texts:
            lines, self._texts = self._texts, []
            self._put(lambda stream: training_plots.log_text(stream, lines, dt))
