# SPDX-License-Identifier: Apache-2.0
"""Steps and episodes that are missing in a stream of serialized messages, without decoding it."""
from __future__ import annotations

import struct
from collections.abc import Callable
from typing import ClassVar
from typing import Protocol

from rocket_sim_node.telemetry.gaps import GapCounter
from rocket_sim_node.telemetry.gaps import of_session

_ONE_STEP = ('rocket_msgs/msg/Observation', 'rocket_msgs/msg/Reward', 'rocket_msgs/msg/Action')
"""Types that begin with session and step, published at each step."""
_ENCODING = 4
"""Bytes before a message, which name its encoding; alignment counts from behind them."""
_FRAME = 8
"""Place of the header's frame behind them: its length, 4 bytes, and its characters."""


_Reader = Callable[[bytes, str], 'tuple[int, int, int] | None']
"""Returns session, first and last step of a message, given '<' or '>', the order of its bytes."""


class MissedCounter(Protocol):
    """Counts what is missing on one topic."""

    unit: ClassVar[str]
    """Name of what is counted."""

    @property
    def missed(self) -> int:
        """How many are missing so far."""

    def note(self, data: bytes) -> str:
        """Note a serialized message; return what is missing before it, '' if nothing is."""


def counter_of(type_name: str) -> MissedCounter | None:
    """Return a counter for messages of a type; None if they are not numbered."""
    if type_name in _ONE_STEP:
        return _StepCounter(_step, whole_sessions=not type_name.endswith('/Action'))
    if type_name == 'rocket_msgs/msg/RocketState':
        return _StepCounter(_steps)
    if type_name == 'rocket_msgs/msg/Episodes':
        return _EpisodeCounter()
    return None


class _StepCounter:
    """Counts missing steps."""

    unit: ClassVar[str] = 'steps'

    def __init__(self, read: _Reader, whole_sessions: bool = True) -> None:
        """Start before the first message.

        :param read: returns session, first and last step of a message; None if it has none.
        :param whole_sessions: as that of `GapCounter`.
        """
        self._read = read
        self._gaps = GapCounter(whole_sessions)

    @property
    def missed(self) -> int:
        """Steps missed so far."""
        return self._gaps.missed

    def note(self, data: bytes) -> str:
        """Note a message; see the protocol."""
        try:
            found = self._read(data, _order(data))
        except struct.error:
            return ''  # the bag's reader reports that the message is cut short
        missing = self._gaps.note(*found) if found else 0
        if not found or not missing:
            return ''
        return f'{missing} steps before step {found[1]} of session {found[0]}'


class _EpisodeCounter:
    """Counts missing episodes: those of a rocket are numbered one after the other.

    Nothing is known of those before a rocket's first one in a session.
    """

    unit: ClassVar[str] = 'episodes'

    def __init__(self) -> None:
        """Start before the first message."""
        self.missed = 0
        """Episodes missed so far."""
        self._next: dict[int, dict[int, int]] = {}

    def note(self, data: bytes) -> str:
        """Note a message; see the protocol."""
        order = _order(data)
        try:
            session, step, count = struct.unpack_from(f'{order}QQI', data, _ENCODING)
            rows = struct.unpack_from(f'{order}{count}I', data, _ENCODING + 20)
            place = 20 + 4 * count + 4  # behind the length of the next sequence
            episodes = struct.unpack_from(f'{order}{count}Q', data, _ENCODING + place + -place % 8)
        except struct.error:
            return ''  # the bag's reader reports that the message is cut short
        following = of_session(self._next, session, {})
        missing = 0
        for row, episode in zip(rows, episodes, strict=True):
            expected = following.get(row, episode)
            missing += max(episode - expected, 0)
            following[row] = max(expected, episode + 1)
        self.missed += missing
        return f'{missing} episodes before step {step} of session {session}' if missing else ''


def _order(data: bytes) -> str:
    """Return the order of a serialized message's bytes, as `struct` names it."""
    return '<' if data[1:2] == b'\x01' else '>'


def _step(data: bytes, order: str) -> tuple[int, int, int]:
    """Return session, step and step of a message that begins with these two."""
    session, step = struct.unpack_from(f'{order}QQ', data, _ENCODING)
    return session, step, step


def _steps(data: bytes, order: str) -> tuple[int, int, int] | None:
    """Return session, first and last step of a message with header, session and steps."""
    (length,) = struct.unpack_from(f'{order}I', data, _ENCODING + _FRAME)
    place = _FRAME + 4 + length
    place += _ENCODING + -place % 8
    # The length of the sequence is aligned to its elements.
    session, count = struct.unpack_from(f'{order}QI', data, place)
    if not count:
        return None
    (first,) = struct.unpack_from(f'{order}Q', data, place + 16)
    (last,) = struct.unpack_from(f'{order}Q', data, place + 8 + 8 * count)
    return session, first, last
