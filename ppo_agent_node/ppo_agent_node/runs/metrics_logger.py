# SPDX-License-Identifier: Apache-2.0
"""Logger of a run's metrics: each iteration becomes a line of `train.jsonl` and a Status."""
from __future__ import annotations

import math
import time
from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import fields
from typing import Any
from typing import NamedTuple

from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.loggers import MakeLogger
from ppo_agent_node.runs.loggers import RunLogger
from rocket_sim_node.telemetry.training_status import Status

TIMES = ('seconds', 'steps_per_second')
"""Entries of a line that depend on the machine; all others follow from the seed."""
_STATUS_FIELDS = frozenset(field.name for field in fields(Status))


class Progress(NamedTuple):
    """Progress towards the end of a stage."""

    progress: int
    goal: int
    unit: str


class MetricsLogger:
    """Writes the log of a run and reports its status."""

    def __init__(
        self, folder: RunFolder, report: Callable[[Status], None],
        dropped: Callable[[], int] = lambda: 0, loggers: Sequence[MakeLogger] = (),
    ) -> None:
        """Start without any lines; see `take_up`.

        :param dropped: returns the number of messages from other participants ignored so far.
        :param loggers: receive all lines, too.
        """
        self._folder, self._report, self._dropped_so_far = folder, report, dropped
        self._dropped = dropped()
        self._began = self._stage_began = self._last = time.monotonic()
        self._stage, self._iterations, self._first, self._steps = '', 0, 0, 0
        self._iteration, self._unit = 0, ''
        self._progress = Progress(0, 0, '')
        self._kept: dict[str, Any] = {'run': folder.name, 'folder': str(folder.path)}
        self.lines = 0
        self._loggers: list[RunLogger] = []
        self._make_loggers = loggers

    def take_up(self, lines: int, steps: int) -> None:
        """Continue after the first `lines` lines, at which `steps` rocket steps had been taken.

        :raises ValueError: when there are fewer lines.
        """
        self._folder.cut_log(lines)
        self.lines, self._steps = lines, steps
        for make in self._make_loggers:
            try:
                self._loggers.append(make(self._folder.path))
            except Exception as error:  # noqa: BLE001  (one of the user's may raise anything)
                self._tell(
                    f'logger {getattr(make, "__name__", make)} cannot be made and is not used: '
                    f'{error!r:.200}')
        if self._loggers:
            log = self._folder.lines()
            self._each(lambda logger: logger.begin(log))

    def close(self) -> None:
        """Close the loggers."""
        self._each(lambda logger: logger.close())
        self._loggers.clear()

    def keep(self, **facts: Any) -> None:
        """Set fields of Status that all further reports contain."""
        self._kept.update(facts)

    def begin(
        self, stage: str, iterations: int, done: int = 0, progress: Progress | None = None,
        unit: str = 'iterations',
    ) -> None:
        """Start a stage of `iterations` iterations, of which `done` were completed earlier.

        :param progress: when the stage does not end by its iterations.
        :param unit: name of its iterations.
        """
        self._stage, self._iterations, self._first, self._unit = stage, iterations, done, unit
        self._iteration = done
        self._progress = progress or Progress(done, iterations, unit)
        self._tell('')
        self._stage_began = self._last = time.monotonic()

    def entry(
        self, iteration: int, steps: int, message: str = '', left: float | None = None,
        progress: Progress | None = None, **numbers: Any,
    ) -> None:
        """Log an iteration of the stage.

        :param steps: rocket steps taken by the run so far.
        :param left: expected remaining iterations, if not those planned.
        :param progress: when the stage does not end by its iterations.
        :param numbers: fields of Status, and others that are only logged.
        :raises OSError: when the log cannot be written.
        """
        now = time.monotonic()
        seconds, taken = now - self._last, steps - self._steps
        self._last, self._steps = now, steps
        before, self._dropped = self._dropped, self._dropped_so_far()
        rate = taken / seconds if taken and seconds > 0 else math.nan
        line = self._folder.append({
            'stage': self._stage, 'iteration': iteration, 'steps': steps, **numbers,
            **({'message': message} if message else {}),
            'messages_dropped': self._dropped - before,
            'seconds': round(seconds, 3),
            'steps_per_second': round(rate) if math.isfinite(rate) else None,
        })
        self.lines += 1
        self._each(lambda logger: logger.entry(line))
        done = iteration - self._first
        left = self._iterations - iteration if left is None else left
        # Iteration 0 of fine-tuning evaluates the clone: its time does not represent the others'.
        each = (now - self._stage_began) / done if done else math.inf
        self._iteration = iteration
        self._progress = progress or Progress(iteration, self._iterations, self._unit)
        if 'level' in numbers:
            self.keep(level=numbers['level'])
        known = {name: value for name, value in numbers.items() if name in _STATUS_FIELDS}
        self._tell(
            message, remaining=each * left if left > 0 else 0.0, steps_per_second=rate, **known)

    def message(self, text: str) -> None:
        """Report an event between two entries; it is not logged."""
        self._tell(text)

    def _each(self, do: Callable[[RunLogger], None]) -> None:
        """Call each logger; drop one that fails, so that it does not end the training."""
        for logger in tuple(self._loggers):
            try:
                do(logger)
            except Exception as error:  # noqa: BLE001  (one of the user's may raise anything)
                self._loggers.remove(logger)
                self._tell(
                    f'logger {type(logger).__name__} failed and is no longer used: {error!r:.200}')

    def _tell(self, message: str, **numbers: Any) -> None:
        self._report(Status(**{
            **self._kept, **self._progress._asdict(), 'stage': self._stage,
            'iteration': self._iteration, 'iterations': self._iterations, 'steps': self._steps,
            'elapsed': time.monotonic() - self._began, 'message': message, **numbers}))
