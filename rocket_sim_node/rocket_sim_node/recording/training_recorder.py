# SPDX-License-Identifier: Apache-2.0
"""An agent's reports on their way into a recording."""
from __future__ import annotations

from collections.abc import Callable

from rocket_sim_node.recording.drawing import training_plots
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.sinks.base import Put

PERIOD, LONGEST_PERIOD = 10.0, 120.0
"""s of wall clock for which reports are gathered before they are logged: at first, and at most"""
PERIOD_SHARE = 1 / 60
"""of the training so far, for which reports are gathered when that is longer"""
MOST_GATHERED = 500
"""reports; that is enough for a chunk, and however fast a training is, little memory"""


class TrainingRecorder:
    """Gathers what an agent reports and logs it together; at once where a stage begins.

    Each logging adds chunks to the recording, and each chunk some 2 KiB to its table of contents:
    the longer a training, the more is gathered.
    """

    def __init__(self, put: Callable[[Put], None], clock: Callable[[], float]) -> None:
        """Begin before the first report.

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
        place = Timepoint(step, self._iterations.add(training))
        if not self._pending and not self._texts:
            self._pending_since = self._clock()
        if training.learning:
            self._pending.add(place, training.values)
        if new_stage:
            self._put(lambda stream: training_plots.log_stage(stream, training.stage, place, dt))
        text = training.message or (f'stage {training.stage}' if new_stage else '')
        if text:
            self._texts.append((place, f'{training.stage}: {text}', 'INFO'))
        if text and (new_stage or not training.learning):
            self.flush(dt)
        self.tick(dt)

    def tick(self, dt: float) -> None:
        """Log what has waited long enough."""
        if not self._pending and not self._texts:
            return
        now = self._clock()
        period = min(max(PERIOD, PERIOD_SHARE * (now - self._began)), LONGEST_PERIOD)
        if now - self._pending_since >= period or len(self._pending) >= MOST_GATHERED:
            self.flush(dt)

    def flush(self, dt: float) -> None:
        """Log what waits."""
        if self._pending:
            places, values = self._pending.take()
            self._put(lambda stream: training_plots.log_training(stream, places, values, dt))
        if self._texts:
            lines, self._texts = self._texts, []
            self._put(lambda stream: training_plots.log_text(stream, lines, dt))
