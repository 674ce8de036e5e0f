# SPDX-License-Identifier: Apache-2.0
"""Decoding of terminal input to keys, and tracking of held keys.

A terminal sends a byte or an escape sequence when a key is pressed, repeats it while the key is
held (after some 0.2 to 0.7 s, then 25 to 30 times a second, only for the last key pressed), and
sends nothing when it is released. Terminals with the kitty keyboard protocol also report repeats
and releases, on request. This module supports both.
"""
from __future__ import annotations

import codecs
import enum
import math
import re
from dataclasses import dataclass
from typing import NamedTuple

EXACT_ON, EXACT_OFF = '\x1b[>11u\x1b[?u', '\x1b[<u'
"""Requests presses, repeats and releases of all keys, and whether that is supported; ends it."""

_ARROWS = {'A': 'up', 'B': 'down', 'C': 'right', 'D': 'left'}
_NAMES = {
    ' ': 'space', '\r': 'enter', '\n': 'enter', '\x03': 'ctrl+c', '\x04': 'ctrl+d',
    '\x1b': 'escape',
}
_SEQUENCE = re.compile(r'\x1b(?:\[([0-?]*)[ -/]*([@-~])|O()([@-~]))')
_UNFINISHED = re.compile(r'\x1b(?:\[[0-?]{0,32}[ -/]{0,4}|O)?\Z')
_BROKEN = re.compile(r'\x1b\[[0-?]*[ -/]*')
_KEY = re.compile(r'(\d+)?(?::[\d:]*)?(?:;(\d*)(?::(\d+))?)?(?:;[\d:]*)?\Z')
_CONTROL = 4
_FUNCTIONAL = range(0xE000, 0xF900)
"""Code points of the protocol for keys that are not characters."""


class Motion(enum.Enum):
    """Type of a key event; a plain terminal only has presses, including repeats."""

    PRESS = 1
    REPEAT = 2
    RELEASE = 3


class KeyEvent(NamedTuple):
    """A key event: a character in lower case, or a name such as `space` or `left`."""

    key: str
    motion: Motion = Motion.PRESS


class KeyReader:
    """Decodes terminal input to keys, however it is split."""

    def __init__(self) -> None:
        """Create an empty buffer."""
        self._decoder = codecs.getincrementaldecoder('utf-8')(errors='ignore')
        self._rest = ''
        self.exact = False
        """Whether the terminal has confirmed that it reports releases."""

    def feed(self, data: bytes) -> list[KeyEvent]:
        """Return the keys in `data`; unknown keys are dropped.

        An incomplete escape sequence is kept until more data arrives.
        """
        text = self._rest + self._decoder.decode(data)
        events: list[KeyEvent] = []
        place = 0
        while place < len(text):
            if text[place] != '\x1b':
                events += _character(text[place])
                place += 1
                continue
            if found := _SEQUENCE.match(text, place):
                parameters, final = found[1] or '', found[2] or found[4]
                self.exact = self.exact or (final == 'u' and parameters.startswith('?'))
                events += _sequence(parameters, final)
                place = found.end()
            elif _UNFINISHED.match(text, place):
                break
            elif broken := _BROKEN.match(text, place):
                place = broken.end()
            else:
                events.append(KeyEvent('escape'))
                place += 1
        self._rest = text[place:]
        return events


def _character(character: str) -> list[KeyEvent]:
    name = _NAMES.get(character, character.lower())
    return [KeyEvent(name)] if len(name) > 1 or name.isprintable() else []


def _sequence(parameters: str, final: str) -> list[KeyEvent]:
    """Return the key of a control sequence, if any: `code;modifiers:motion` and a letter."""
    parts = _KEY.match(parameters)
    if parts is None or (final not in _ARROWS and final != 'u'):
        return []
    try:
        motion = Motion(int(parts[3] or 1))
    except ValueError:
        return []
    if final in _ARROWS:
        return [KeyEvent(_ARROWS[final], motion)]
    code = int(parts[1] or 0)
    if not 0 < code < 0x110000 or code in _FUNCTIONAL:
        return []
    control = int(parts[2] or 1) - 1 & _CONTROL
    key = f'ctrl+{chr(code)}' if control else ''.join(e.key for e in _character(chr(code)))
    return [KeyEvent(key, motion)] if key else []


@dataclass
class _Hold:
    """A key that is held."""

    heard: float
    until: float
    repeating: bool


class HeldKeys:
    """Tracks which keys are held.

    Reported releases are exact. Without them, a press counts as held for `delay` s, within which a
    terminal's first repeat should arrive, and each of the fast repeats that follow for `gap` s. As
    pressing a second key ends the repeats of the first, a repeating key stays held as long as the
    key that interrupted it.
    """

    _QUICK = 0.09
    """s between two presses that only a terminal's repeats can reach."""

    def __init__(self, delay: float, gap: float) -> None:
        """Start without held keys."""
        self._delay, self._gap = delay, gap
        self._holds: dict[str, _Hold] = {}
        self._exact = False

    def move(self, event: KeyEvent, now: float, delay: float | None = None) -> None:
        """Handle an event.

        :param now: s, from a monotonic clock.
        :param delay: s that a press of this key counts as held, if not the default.
        """
        if event.motion is Motion.RELEASE:
            self.release(event.key)
            self._exact = True
            return
        self._exact = self._exact or event.motion is Motion.REPEAT
        before = self._holds.get(event.key)
        repeating = before is not None and now - before.heard < self._QUICK
        delay = self._delay if delay is None else delay
        until = math.inf if self._exact else now + (self._gap if repeating else delay)
        self._holds[event.key] = _Hold(now, until, repeating)
        for key, hold in self._holds.items():
            if key != event.key and hold.repeating and hold.until >= now:
                hold.until = max(hold.until, until)

    def release(self, *keys: str) -> None:
        """Mark keys as released."""
        for key in keys:
            self._holds.pop(key, None)

    def clear(self) -> None:
        """Mark all keys as released."""
        self._holds.clear()

    def held(self, key: str, now: float) -> bool:
        """Return whether a key is held at a time, s."""
        hold = self._holds.get(key)
        return hold is not None and now <= hold.until

    def know_releases(self) -> None:
        """Rely on reported releases from now on."""
        self._exact = True
