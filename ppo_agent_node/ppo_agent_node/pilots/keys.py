# SPDX-License-Identifier: Apache-2.0
"""What a terminal sends, as keys; and which keys are held down, as well as can be known.

A terminal sends a byte or an escape sequence when a key goes down, again and again while it is
held (after some 0.2 to 0.7 s, then 25 to 30 times a second, and for the last key pressed alone),
and nothing when it comes up. Terminals that speak the kitty keyboard protocol also tell of
repeats and releases, once asked to. Both are understood here.
"""
from __future__ import annotations

import codecs
import enum
import math
import re
from dataclasses import dataclass
from typing import NamedTuple

EXACT_ON, EXACT_OFF = '\x1b[>11u\x1b[?u', '\x1b[<u'
"""Ask for presses, repeats and releases of all keys, and whether that is understood; stop it."""

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
"""Where the protocol keeps keys that are no characters"""


class Motion(enum.Enum):
    """What a key did; a plain terminal knows presses only, and its repeats are presses."""

    PRESS = 1
    REPEAT = 2
    RELEASE = 3


class KeyEvent(NamedTuple):
    """A key that moved: a character in lower case, or a name such as `space` or `left`."""

    key: str
    motion: Motion = Motion.PRESS


class KeyReader:
    """Turns what a terminal sends into keys, however it is cut into pieces."""

    def __init__(self) -> None:
        """Begin with nothing read."""
        self._decoder = codecs.getincrementaldecoder('utf-8')(errors='ignore')
        self._rest = ''
        self.exact = False
        """Whether the terminal has said that it tells of releases."""

    def feed(self, data: bytes) -> list[KeyEvent]:
        """Return the keys in `data`; what is no key we know is left out.

        An escape sequence that is not complete waits for more.
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
    """A key that is down."""

    heard: float
    until: float
    repeating: bool


class HeldKeys:
    """Which keys are down.

    With releases told, that is known. Without, a press counts as held for `delay` s, in which a
    terminal's first repeat should come, and each of the quick repeats that follow for `gap` s.
    As pressing a second key ends the repeats of the first, a key that was repeating stays down
    as long as the one that broke in.
    """

    _QUICK = 0.09
    """s between two presses that no finger can do, but a terminal's repeats"""

    def __init__(self, delay: float, gap: float) -> None:
        """Begin with no key down."""
        self._delay, self._gap = delay, gap
        self._holds: dict[str, _Hold] = {}
        self._exact = False

    def move(self, event: KeyEvent, now: float, delay: float | None = None) -> None:
        """Take note of an event.

        :param now: s, from a clock that never goes back.
        :param delay: s that a press of this key counts as held, if not the usual.
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
        """Take keys as up."""
        for key in keys:
            self._holds.pop(key, None)

    def clear(self) -> None:
        """Take all keys as up."""
        self._holds.clear()

    def held(self, key: str, now: float) -> bool:
        """Return whether a key is down at a time, s."""
        hold = self._holds.get(key)
        return hold is not None and now <= hold.until

    def know_releases(self) -> None:
        """Believe from now on that each release will be told."""
        self._exact = True
