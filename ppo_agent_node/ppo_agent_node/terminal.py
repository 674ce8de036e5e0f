# SPDX-License-Identifier: Apache-2.0
"""How a run looks to who waits for it: a live line on a terminal, plain lines in a log."""
from __future__ import annotations

import math
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn
from rich.progress import MofNCompleteColumn
from rich.progress import Progress
from rich.progress import TextColumn

from ppo_agent_node.learning.status import Status

_STAGES = {
    'demonstrate': 'expert flies', 'clone': 'cloning', 'finetune': 'PPO', 'evaluate': 'evaluating',
    'done': 'done',
}


def describe(status: Status) -> str:
    """Return the figures of a report as a person reads them; what is not known is left out."""
    parts = []
    if status.level and status.stage in ('finetune', 'evaluate'):
        parts.append(f'level {status.level}')
    if math.isfinite(status.landing_rate):
        parts.append(f'landed {status.landing_rate:.1%}')
    if math.isfinite(status.mean_return):
        parts.append(f'return {status.mean_return:.1f}')
    if math.isfinite(status.clone_validation_loss):
        parts.append(f'validation loss {status.clone_validation_loss:.5f}')
    if math.isfinite(status.steps_per_second):
        parts.append(f'{status.steps_per_second:,.0f} steps/s')
    if math.isfinite(status.remaining):
        parts.append(f'{_minutes(status.remaining)} left')
    return ', '.join(parts)


def _minutes(seconds: float) -> str:
    return f'{int(seconds) // 60}:{int(seconds) % 60:02d}'


class Terminal:
    """Shows reports as they come. Use as a context, so that the terminal is left in order."""

    def __init__(self, file: TextIO | None = None) -> None:
        """Show on standard output, or on `file`."""
        self._console = Console(file=file, highlight=False, soft_wrap=True)
        self._progress = Progress(
            TextColumn('{task.fields[stage]:<12}'), BarColumn(bar_width=20),
            MofNCompleteColumn(), TextColumn('{task.fields[figures]}'),
            console=self._console, transient=True, auto_refresh=False,
        )
        self._live = self._console.is_terminal
        self._task = None if not self._live else self._progress.add_task(
            '', total=None, stage='waiting', figures='')

    def __enter__(self) -> Terminal:
        """Begin to show."""
        if self._live:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the terminal as it was."""
        if self._live:
            self._progress.stop()

    def say(self, text: str) -> None:
        """Write a line that stays."""
        self._console.print(text, markup=False)

    def show(self, status: Status) -> None:
        """Show a report: what happened stays as a line, how far it is replaces what was there."""
        stage = _STAGES.get(status.stage, status.stage)
        figures = describe(status)
        if self._task is not None:
            self._progress.update(
                self._task, stage=stage, figures=figures, completed=status.iteration,
                total=status.iterations or None, refresh=True)
            if status.message:
                self.say(f'  {_minutes(status.elapsed)} {stage}: {status.message}')
            return
        parts = [p for p in (figures, status.message) if p]
        count = f' {status.iteration}/{status.iterations}' if status.iterations else ''
        self.say(f'[{_minutes(status.elapsed)}] {stage}{count}: {"; ".join(parts)}')
