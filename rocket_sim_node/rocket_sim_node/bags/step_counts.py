# SPDX-License-Identifier: Apache-2.0
"""Steps that are missing in a stream of serialized messages, without decoding them."""
from __future__ import annotations

import struct

from rocket_sim_node.telemetry.gaps import GapCounter

_ONE_STEP = ('rocket_msgs/msg/Observation', 'rocket_msgs/msg/Reward', 'rocket_msgs/msg/Action')
"""Types that begin with session and step, published at each step."""
_MANY_STEPS = 'rocket_msgs/msg/RocketState'
"""Type that begins with a header, a session and a sequence of steps."""
_ENCODING = 4
"""Bytes before a message, which name its encoding; alignment counts from behind them."""
_FRAME = 8
"""Place of the header's frame behind them: its length, 4 bytes, and its characters."""


class StepCounter:
    """Counts the steps missed on one topic, within each session."""

    def __init__(self, type_name: str) -> None:
        """Begin before the first message of a type; of most types there is nothing to count."""
        self._type = type_name
        self._gaps = GapCounter()

    @property
    def missed(self) -> int:
        """Steps missed so far."""
        return self._gaps.missed

    def note(self, data: bytes) -> tuple[int, int, int] | None:
        """Note a serialized message.

        :return: session, first step after a gap and number of missed steps, if there is one.
        """
        if self._type not in _ONE_STEP and self._type != _MANY_STEPS:
            return None
        order = '<' if data[1:2] == b'\x01' else '>'
        try:
            if self._type == _MANY_STEPS:
                (length,) = struct.unpack_from(f'{order}I', data, _ENCODING + _FRAME)
                place = _FRAME + 4 + length
                place += _ENCODING + -place % 8
                # The length of the sequence is aligned to its elements.
                session, count = struct.unpack_from(f'{order}QI', data, place)
                if not count:
                    return None
                (first,) = struct.unpack_from(f'{order}Q', data, place + 16)
                (last,) = struct.unpack_from(f'{order}Q', data, place + 8 + 8 * count)
            else:
                session, first = struct.unpack_from(f'{order}QQ', data, _ENCODING)
                last = first
        except struct.error:
            return None  # the bag's reader reports that the message is cut short
        missing = self._gaps.note(session, first, last)
        return (session, first, missing) if missing else None
