# SPDX-License-Identifier: Apache-2.0
"""Output of a run's status: in place on a terminal, otherwise in plain lines."""
from __future__ import annotations

import io
import os
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import TextIO

from rich.console import Console
from rich.text import Text

from ppo_agent_node.terminal import formatting
from ppo_agent_node.terminal.live_display import LiveDisplay
from ppo_agent_node.terminal.status_lines import StatusLines
from rocket_sim_node.printable import printable
from rocket_sim_node.telemetry.training_status import Status

VARIABLE = 'HOVERSLAM_TERMINAL'
"""Environment variable with the terminal to use when standard output is a pipe to a launch."""
_REFRESH = 0.25
"""Minimum seconds between two redraws."""
_UNSHOWN = (OSError, UnicodeError)
"""Errors of a closed terminal or a missing character, which must not end a training."""
_MANY = 100
_PERIOD = 5.0
"""Minimum seconds between plain lines, in stages of many iterations."""


class Terminal:
    """Shows status reports. Use as a context, so that the terminal is restored."""

    def __init__(self, file: TextIO | None = None) -> None:
        """Show on `file`; by default on the terminal in the environment, else standard output."""
        self._own = _named() if file is None else None
        shown = file or self._own or sys.stdout
        if isinstance(shown, io.TextIOWrapper):
            # rich marks a cut line with an ellipsis, even if the terminal lacks the character.
            shown.reconfigure(errors='replace')
        self._console = Console(file=shown, highlight=False, soft_wrap=True)
        self._live_display: LiveDisplay | None = None
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._live_display = LiveDisplay(self._console)
        self._picture = StatusLines('utf' in self._console.encoding)
        self._drawn = self._printed = -1e9
        self._stage = ''

    def __enter__(self) -> Terminal:
        """Start the display."""
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal."""
        with suppress(*_UNSHOWN):
            if self._live_display is not None:
                self._live_display.draw([])
        if self._own is not None:
            with suppress(OSError):
                self._own.close()

    @property
    def live(self) -> bool:
        """Whether the display is redrawn in place."""
        return self._live_display is not None

    def wait_for(self, what: str, status: Status) -> None:
        """Show that the run waits for something; plain output omits it."""
        if self._live_display is not None:
            self._picture.take(replace(status, stage=f'waiting for {what}'))
            self._draw()

    def say(self, text: str, style: str = '') -> None:
        """Write permanent lines."""
        self._stay(Text(text, style))

    def show(self, status: Status) -> None:
        """Show a report: events become permanent lines, progress replaces the previous one."""
        self._picture.take(status)
        if self._live_display is None:
            if self._due(status):
                self.say(formatting.line(status))
        elif status.message:
            self._stay(_event(status))
        else:
            self._draw()

    def tick(self) -> None:
        """Update clocks; cheap, to be called often."""
        if self._live_display is not None and time.monotonic() - self._drawn > _REFRESH:
            self._draw()

    def _due(self, status: Status) -> bool:
        """Return whether a report is worth a plain line."""
        if not status.message and not status.is_iteration:
            return False
        done, goal, _ = formatting.counted(status)
        now = time.monotonic()
        due = (
            status.message or status.iterations <= _MANY or status.iteration <= 1 or done >= goal
            or status.stage != self._stage or now - self._printed >= _PERIOD)
        if due:
            self._printed, self._stage = now, status.stage
        return bool(due)

    def _draw(self, above: Text | None = None) -> None:
        if self._live_display is None:
            return
        self._drawn = time.monotonic()
        with suppress(*_UNSHOWN):
            self._live_display.draw(self._picture.lines(self._live_display.width), above)

    def _stay(self, text: Text) -> None:
        # Parts of it may come from other nodes, and must not control the terminal.
        text.plain = printable(text.plain, '\n\t')
        if self._live_display is None:
            with suppress(*_UNSHOWN):
                self._console.print(text)
                self._console.file.flush()
            return
        self._draw(text)


def _event(status: Status) -> Text:
    """Return an event as a line."""
    where = formatting.stage_name(status.stage)
    if status.stage == 'finetune' and status.iteration:
        where += f' {status.iteration}'
    when = f'{formatting.duration(status.elapsed):>7}  '
    return Text.assemble((when, 'dim'), (where, 'cyan'), f'  {status.message}', no_wrap=True)


def _named() -> TextIO | None:
    """Return the terminal that the environment names, if it is writable."""
    path = os.environ.get(VARIABLE)
    if not path:
        return None
    try:
        number = os.open(path, os.O_WRONLY | os.O_NOCTTY)
    except OSError:
        return None
    if os.isatty(number):
        return os.fdopen(number, 'w', encoding=sys.stdout.encoding)
    os.close(number)
    return None
