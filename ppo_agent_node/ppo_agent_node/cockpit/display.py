# SPDX-License-Identifier: Apache-2.0
"""Display for hand flying: instruments, with the time left until the burn in front."""
from __future__ import annotations

import io
import math
import shutil
from dataclasses import dataclass
from dataclasses import field

from rich.console import Console
from rich.text import Text

from ppo_agent_node.cockpit.instruments import Brake
from ppo_agent_node.cockpit.instruments import Readings

KEYS = (
    ('w / s', 'throttle up / down a step'),
    ('z / x', 'full throttle / engine off'),
    ('1 to 9', 'throttle 10 to 90 %'),
    ('space', 'full throttle while held'),
    ('arrows', 'lean: left, right, away, nearer'),
    ('r', 'fly: the next start'),
    ('t', 'try the same start again'),
    ('h', 'help'),
    ('q', 'quit'),
)
_LABEL = 10
_NARROW = 64
_SOON = 1.0
"""Seconds before the last chance to brake at which the warning begins."""
_LANDED, _WARN, _BAD, _DIM, _HEAD = 'bold green', 'bold yellow', 'bold red', 'dim', 'bold'
_ARROWS = '→↗↑↖←↙↓↘'


@dataclass(frozen=True)
class Tank:
    """State of the vehicle that is not part of the observation."""

    mass: float
    """kg."""
    fuel: float
    """kg."""
    full: float
    """kg of fuel at the start; 0 in worlds without fuel."""
    throttle: float
    """0 to 1, actual."""
    time: float
    """s since the start."""
    brake: Brake
    """Braking model of this flight's vehicle."""


@dataclass
class View:
    """Content of the display."""

    title: str
    ceiling: float
    """m, upper end of the height scale."""
    limits: tuple[float, float, float]
    """Limits of a landing: m/s, deg, m; 0 if the world has none."""
    readings: Readings | None = None
    tank: Tank | None = None
    summary: str = ''
    notes: list[tuple[str, str]] = field(default_factory=list)
    """Lines below the instruments: style and text."""
    flying: bool = False
    help: bool = False
    message: str = ''


class Cockpit:
    """Renders a view as the lines of a terminal."""

    def __init__(self, color: bool | None = None) -> None:
        """Prepare the terminal's text.

        :param color: whether to use colours; None: as the terminal supports.
        """
        self._buffer = io.StringIO()
        self._console = Console(
            file=self._buffer, force_terminal=True, highlight=False, legacy_windows=False,
            no_color=None if color is None else not color)

    def lines(self, view: View, size: tuple[int, int] | None = None) -> list[str]:
        """Return the screen as lines that fit in number and length.

        :param size: columns and rows; None: those of the terminal.
        """
        width, height = size or shutil.get_terminal_size()
        width = max(width, 20)
        # The last column stays free, because a terminal may wrap there.
        texts = self._compose(view, width - 1)
        if len(texts) > height:
            texts = [text for text in texts if text.plain.strip()]
        self._console.size = (width, max(height, 1))
        self._buffer.seek(0)
        self._buffer.truncate()
        for text in texts[:max(height, 1)]:
            text.truncate(width - 1, overflow='ellipsis')
            self._console.print(text, no_wrap=True, overflow='crop', crop=True)
        return self._buffer.getvalue().split('\n')[:-1]

    def _compose(self, view: View, width: int) -> list[Text]:
        title = Text().append(f' {view.title}', style=_HEAD)
        if view.summary and len(title) + len(view.summary) + 3 <= width:
            title.pad_right(width - len(title) - len(view.summary) - 1)
            title.append(view.summary)
        texts = [title, Text('─' * width, style=_DIM)]
        if view.help:
            return [*texts, *_help(), *self._notes(view, width)]
        if view.readings is not None and view.tank is not None:
            texts += self._instruments(view, view.readings, view.tank, width)
        texts += self._notes(view, width)
        if view.flying:
            keys = ' space burn   z full   x off   w/s throttle   arrows lean   r new   q quit'
            texts += [Text(), Text(
                keys if width > len(keys) else ' space z x w s · arrows · r q', style=_DIM)]
        return texts

    def _instruments(
        self, view: View, readings: Readings, tank: Tank, width: int,
    ) -> list[Text]:
        speed = max(-readings.climb, 0.0)
        stop = tank.brake.height(speed, tank.mass)
        bar = max(width - _LABEL - 3, 8)
        fast, tilted, far = view.limits
        arrow = '↓' if readings.climb < 0 else '↑'
        texts = [
            Text(),
            _line('height', f'{readings.height:6.1f} m', self._burn_advice(
                view.flying, readings, tank, stop, width < _NARROW)),
            _line('', '', _scale(readings.height, stop, view.ceiling, bar)),
            _line('to stop', f'{stop:6.1f} m' if math.isfinite(stop) else '   never',
                  Text('at full throttle from now on' if width >= _NARROW else '', style=_DIM)),
            Text(),
            _line('speed', f'{arrow}{abs(readings.climb):5.1f} m/s', _vector(
                'drift', readings.drift, 'm/s', width),
                _LANDED if math.hypot(readings.climb, *readings.drift) < fast else _HEAD),
            _line('tilt', f'{readings.tilt:6.1f} °', _vector(
                'offset', readings.offset, 'm', width, far),
                _LANDED if readings.tilt < tilted else _HEAD),
            Text(),
            _line('throttle', f'{tank.throttle:6.0%}', _bar(
                tank.throttle, bar - 14, 'bold cyan' if tank.throttle else _DIM)),
        ]
        if tank.full:
            part = tank.fuel / tank.full
            texts.append(_line('fuel', f'{tank.fuel:6.0f} kg', _bar(
                part, bar - 14, _BAD if part < 0.2 else 'cyan')))
        texts.append(_line('time', f'{tank.time:6.2f} s', Text()))
        return texts

    def _notes(self, view: View, width: int) -> list[Text]:
        """Return the notes, with long lines wrapped."""
        notes = [('', ''), *view.notes] if view.notes else []
        if view.message:
            notes += [('', ''), (_WARN, view.message)]
        texts = []
        for style, note in notes:
            parts = Text().append(note, style=style).wrap(self._console, width - 1)
            texts += [Text(' ').append_text(part) for part in parts] or [Text()]
        return texts

    def _burn_advice(
        self, flying: bool, readings: Readings, tank: Tank, stop: float, short: bool,
    ) -> Text:
        """Return how long full throttle can wait, or what can no longer be prevented."""
        def say(style: str, long: str, brief: str) -> Text:
            return Text().append(brief if short else long, style=style)

        speed = -readings.climb
        if not flying or readings.height <= 0 or speed <= 0:
            return Text()
        if stop > readings.height:
            hit = tank.brake.touchdown_speed(readings.height, speed, tank.mass)
            if hit < 0.5:
                return say(_BAD, 'BURN: now or never', 'BURN NOW')
            return say(
                _BAD, f'TOO LATE: at least {hit:.0f} m/s at the ground', f'LATE: {hit:.0f} m/s')
        wait = tank.brake.wait(readings.height, speed, tank.mass)
        if tank.throttle > 0.0:
            left = f'{readings.height - stop:+.1f} m'
            return say(_LANDED, f'braking: {left} to spare', f'braking {left}')
        style = _WARN if wait < _SOON else ''
        return say(
            style, f'full throttle in {wait:.2f} s at the latest', f'full in {wait:.2f} s')


def _line(label: str, value: str, rest: Text, style: str = _HEAD) -> Text:
    text = Text().append(f' {label:<{_LABEL - 1}}', style=_DIM)
    if value:
        text.append(f'{value:<12} ', style=style)
    return text.append_text(rest)


def _cells(part: float, width: int) -> int:
    return round(min(max(part, 0.0), 1.0) * width) if math.isfinite(part) else width


def _bar(part: float, width: int, style: str) -> Text:
    width = max(width, 4)
    full = _cells(part, width)
    return Text().append('█' * full, style=style).append('░' * (width - full), style=_DIM)


def _scale(height: float, stop: float, ceiling: float, width: int) -> Text:
    """Return the height scale from the ground up, with stopping distance and vehicle."""
    width -= 1
    needed, place = _cells(stop / ceiling, width), min(_cells(height / ceiling, width), width - 1)
    late = stop > height
    text = Text().append('▕', style=_DIM)
    for low, high in ((0, place), (place + 1, width)):
        full = min(max(needed, low), high)
        text.append('█' * (full - low), style='red' if late else 'yellow')
        text.append('·' * (high - full), style=_DIM)
        if low == 0:
            text.append('◆', style=_BAD if late else _HEAD)
    return text


def _vector(
    name: str, vector: tuple[float, float], unit: str, width: int, limit: float = 0.0,
) -> Text:
    """Return a horizontal vector: size and direction, seen from above with z downwards."""
    x, z = vector
    size = math.hypot(x, z)
    style = _LANDED if size < limit else _HEAD
    direction = ' ' if size < 0.05 else _ARROWS[round(math.atan2(-z, x) / (math.pi / 4)) % 8]
    text = Text().append(f'{name:<7}', style=_DIM)
    text.append(f'{direction}{size:5.1f}', style=style)
    if width >= _NARROW:
        text.append(f' {unit:<4}', style=style)
    if width >= _NARROW and size >= 0.05:
        text.append(f'  ({round(x, 1) + 0.0:+.1f}, {round(-z, 1) + 0.0:+.1f})', style=_DIM)
    return text


def _help() -> list[Text]:
    return [Text(), *(
        Text().append(f' {key:<8}', style=_HEAD).append(f' {what}') for key, what in KEYS)]
