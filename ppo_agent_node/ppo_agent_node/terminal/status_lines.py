# SPDX-License-Identifier: Apache-2.0
"""Layout of a run's status as a few lines of text for a given width."""
from __future__ import annotations

import math
import time
from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import fields
from dataclasses import replace

from rich.text import Text

from ppo_agent_node.terminal import formatting
from ppo_agent_node.terminal.sparkline import sparkline
from rocket_sim_node.telemetry.training_status import Status

NARROW = 60
"""Columns below which the layout has two short lines."""
_WIDE = 100
_LABEL = 8
_SPARK = 40
_BAR = 40
_GAP = '   '
_BLANK = replace(Status(), stage='waiting')
_CURVES = {
    'finetune': (('return', 'mean_return', '.1f'), ('landed', 'landing_rate', '.0%')),
    'clone': (('loss', 'clone_validation_loss', '.5f'),),
    'demonstrate': (), 'evaluate': (),
}


class StatusLines:
    """State of a run, rendered on demand."""

    def __init__(
        self, unicode: bool = True, clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without reports.

        :param unicode: whether the terminal supports more than ASCII.
        """
        self._unicode, self._clock = unicode, clock
        self._status = _BLANK
        self._told = self._clock()
        self._history: dict[str, list[float]] = {}

    def take(self, status: Status) -> None:
        """Add a report; an event keeps the figures of the last iteration."""
        now = self._clock()
        same, is_iteration = status.stage == self._status.stage, status.is_iteration
        if same and not status.is_iteration:
            before = self._status
            unsaid = {
                field.name: getattr(before, field.name) for field in fields(Status)
                if _unknown(getattr(status, field.name))}
            left = before.remaining - (now - self._told)
            status = replace(status, **{**unsaid, 'remaining': left})
        self._status = status
        self._told = now
        if not same:
            self._history = {}
        for _, field, _ in _CURVES.get(status.stage, ()):
            value = getattr(status, field)
            if is_iteration and math.isfinite(value):
                self._history.setdefault(field, []).append(value)

    def lines(self, width: int) -> list[Text]:
        """Return the lines, none wider than `width` columns."""
        status, since = self._status, self._clock() - self._told
        status = replace(
            status, elapsed=status.elapsed + since, remaining=status.remaining - since)
        lines = self._narrow(status, width) if width < NARROW else self._broad(status, width)
        for line in lines:
            line.truncate(max(1, width), overflow='ellipsis' if self._unicode else 'crop')
        return lines

    def _narrow(self, status: Status, width: int) -> list[Text]:
        parts = [_name(status)]
        if count := formatting.count_text(status):
            parts.append(count.removesuffix(' episodes'))
        if 0 < status.remaining < math.inf:
            parts.append(f'{formatting.duration(status.remaining)} left')
        more = [f'level {status.level}'] if status.level and status.stage == 'finetune' else []
        if math.isfinite(status.landing_rate):
            more.append(f'landed {status.landing_rate:.0%}')
        if math.isfinite(status.mean_return):
            more.append(f'return {status.mean_return:.0f}')
        if math.isfinite(status.clone_validation_loss):
            more.append(f'loss {status.clone_validation_loss:.4f}')
        if math.isfinite(status.best_return):
            more.append(f'best {status.best_return:.0f}')
        head = Text(_fitting(parts, width, ' '))
        head.stylize('bold cyan', 0, len(parts[0]))
        return [head, Text(_fitting(more, width, ' '))] if more else [head]

    def _broad(self, status: Status, width: int) -> list[Text]:
        lines = [self._stages(status, width), self._bar(status, width)]
        facts = formatting.figures(status)
        if status.steps:
            facts.append(f'{formatting.amount(status.steps)} steps')
        lines += _flowing(facts, width)
        quiet = [
            text for text in (formatting.without_noise(status), formatting.best(status)) if text]
        lines += _flowing(quiet, width, 'dim')
        lines += self._curves(status, width)
        if status.saved:
            where = f' in {status.folder}' if status.folder else ''
            text = Text.assemble(('saved'.ljust(_LABEL), 'dim'), status.saved)
            room = width - len(text)
            if len(where) > room > 12:
                where = f' in {"…" if self._unicode else ""}{where[len(where) - room + 5:]}'
            lines.append(text.append(where if len(where) <= room else ''))
        return lines

    def _stages(self, status: Status, width: int) -> Text:
        """Return all stages, with completed ones ticked off and the current one marked."""
        done, now, later = ('✓', '▶', '·') if self._unicode else ('x', '>', '.')
        stages = status.stages or (status.stage,)
        present = stages.index(status.stage) if status.stage in stages else len(stages)
        text = Text()
        for number, stage in enumerate(stages):
            mark, style = (
                (done, 'green') if number < present else
                (now, 'bold cyan') if number == present else (later, 'dim'))
            text.append(f'{mark} {formatting.stage_name(stage)}', style).append(_GAP)
        if status.run and len(text) + len(status.run) <= width:
            text.append(status.run, 'dim')
        text.rstrip()
        return text

    def _bar(self, status: Status, width: int) -> Text:
        """Return the progress bar of the stage."""
        done, goal, unit = formatting.counted(status)
        clock = [f'{formatting.duration(status.elapsed)} gone']
        if math.isfinite(status.remaining):
            clock.append(f'{formatting.duration(status.remaining)} left')
        if not goal:
            return Text(_GAP.join(clock))
        part = min(1.0, done / goal)
        text = f'{done}/{goal} {unit}'.strip() + f'{_GAP}{part:.0%}{_GAP}' + ', '.join(clock)
        length = max(0, min(_BAR, width - len(text) - len(_GAP)))
        full, rest = ('━', '─') if self._unicode else ('#', '-')
        filled = int(part * length)
        return Text.assemble(
            (full * filled, 'cyan'), (rest * (length - filled), 'dim'), _GAP if length else '',
            text)

    def _curves(self, status: Status, width: int) -> list[Text]:
        """Return the curves of the stage so far, side by side if they fit."""
        curves = []
        for label, field, form in _CURVES.get(status.stage, ()):
            values = self._history.get(field, [])
            if len(values) < 2:
                continue
            ends = f'{values[0]:{form}} {"→" if self._unicode else "->"} {values[-1]:{form}}'
            part = (width - len(_GAP)) // 2 if width >= _WIDE else width
            room = min(_SPARK, part - _LABEL - len(ends) - 2)
            low, high = (0.0, 1.0) if field == 'landing_rate' else (None, None)
            curve = sparkline(values, room, low, high, self._unicode)
            curves.append(Text.assemble(
                (label.ljust(_LABEL), 'dim'), (curve, 'cyan'), f'  {ends}'))
        if len(curves) == 2 and width >= _WIDE:
            return [Text.assemble(curves[0], _GAP, curves[1])]
        return curves


def _unknown(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _name(status: Status) -> str:
    return formatting.stage_name(status.stage)


def _fitting(parts: Sequence[str], width: int, gap: str) -> str:
    """Return as many of the parts, from the first, as fit into a line."""
    text = ''
    for part in parts:
        longer = f'{text}{gap}{part}' if text else part
        if text and len(longer) > width:
            break
        text = longer
    return text


def _flowing(parts: Sequence[str], width: int, style: str = '') -> list[Text]:
    """Return all parts, wrapped between parts into as many lines as needed."""
    lines: list[str] = []
    for part in parts:
        if lines and len(lines[-1]) + len(_GAP) + len(part) <= width:
            lines[-1] += _GAP + part
        else:
            lines.append(part)
    return [Text(line, style) for line in lines]
