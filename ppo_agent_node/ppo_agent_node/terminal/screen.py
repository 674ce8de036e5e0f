# SPDX-License-Identifier: Apache-2.0
"""Where a run is shown: on a terminal in place, elsewhere in plain lines."""
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

from ppo_agent_node.runs.status import Status
from ppo_agent_node.terminal import wording
from ppo_agent_node.terminal.block import Block
from ppo_agent_node.terminal.status_lines import StatusLines
from rocket_sim_node.printable import printable

VARIABLE = 'HOVERSLAM_TERMINAL'
"""names the terminal to show on, where standard output is a pipe to a launch"""
_REFRESH = 0.25
"""s between two pictures, at least"""
_UNSHOWN = (OSError, UnicodeError)
"""A terminal that went away, or lacks a character, must not end a training."""
_MANY = 100
_PERIOD = 5.0
"""stages of more iterations get a plain line no more often, s"""


class Terminal:
    """Shows reports as they come. Use as a context, so that the terminal is left in order."""

    def __init__(self, file: TextIO | None = None) -> None:
        """Show on `file`; by default on the terminal that is named, else standard output."""
        self._own = _named() if file is None else None
        shown = file or self._own or sys.stdout
        if isinstance(shown, io.TextIOWrapper):
            # rich has an ellipsis where a line is cut, whatever the terminal's characters are.
            shown.reconfigure(errors='replace')
        self._console = Console(file=shown, highlight=False, soft_wrap=True)
        self._block: Block | None = None
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._block = Block(self._console)
        self._picture = StatusLines('utf' in self._console.encoding)
        self._drawn = self._printed = -1e9
        self._stage = ''

    def __enter__(self) -> Terminal:
        """Begin to show."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the terminal as it was."""
        with suppress(*_UNSHOWN):
            if self._block is not None:
                self._block.draw([])
        if self._own is not None:
            with suppress(OSError):
                self._own.close()

    @property
    def live(self) -> bool:
        """Whether this is a display that stays in place."""
        return self._block is not None

    def wait_for(self, what: str, status: Status) -> None:
        """Show that nothing is to be seen yet, for want of something; a log does without."""
        if self._block is not None:
            self._picture.take(replace(status, stage=f'waiting for {what}'))
            self._draw()

    def say(self, text: str, style: str = '') -> None:
        """Write lines that stay."""
        self._stay(Text(text, style))

    def show(self, status: Status) -> None:
        """Show a report: what happened stays as a line, how far it is replaces what was there."""
        self._picture.take(status)
        if self._block is None:
            if self._due(status):
                self.say(wording.line(status))
        elif status.message:
            self._stay(_event(status))
        else:
            self._draw()

    def tick(self) -> None:
        """Let the clocks go on; call it often, it is cheap."""
        if self._block is not None and time.monotonic() - self._drawn > _REFRESH:
            self._draw()

    def _due(self, status: Status) -> bool:
        """Tell whether a report is worth a plain line."""
        if not status.message and not status.is_iteration:
            return False
        done, goal, _ = wording.counted(status)
        now = time.monotonic()
        told = (
            status.message or status.iterations <= _MANY or status.iteration <= 1 or done >= goal
            or status.stage != self._stage or now - self._printed >= _PERIOD)
        if told:
            self._printed, self._stage = now, status.stage
        return bool(told)

    def _draw(self, above: Text | None = None) -> None:
        if self._block is None:
            return
        self._drawn = time.monotonic()
        with suppress(*_UNSHOWN):
            self._block.draw(self._picture.lines(self._block.width), above)

    def _stay(self, text: Text) -> None:
        # Some of it may be anybody's words, which shall not command the terminal.
        text.plain = printable(text.plain, '\n\t')
        if self._block is None:
            with suppress(*_UNSHOWN):
                self._console.print(text)
                self._console.file.flush()
            return
        self._draw(text)


def _event(status: Status) -> Text:
    """Return what happened as a line."""
    where = wording.stage_name(status.stage)
    if status.stage == 'finetune' and status.iteration:
        where += f' {status.iteration}'
    when = f'{wording.duration(status.elapsed):>7}  '
    return Text.assemble((when, 'dim'), (where, 'cyan'), f'  {status.message}', no_wrap=True)


def _named() -> TextIO | None:
    """Return the terminal that the environment names, if it can be written to."""
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
