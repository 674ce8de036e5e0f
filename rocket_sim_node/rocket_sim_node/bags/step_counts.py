# SPDX-License-Identifier: Apache-2.0
"""Steps that are missing in a stream of serialized messages, without decoding them."""
from __future__ import annotations

import struct

from rocket_sim_node.telemetry.gaps import GapCounter

_ONE_STEP = ('rocket_msgs/msg/Observation', 'rocket_msgs/msg/Reward', 'rocket_msgs/msg/Action')
"""Types that begin with session and step, published at each step."""
_MANY_STEPS = 'rocket_msgs/msg/RocketState'
"""Type that begins with a session and a sequence of steps."""
_FIRST = 20
"""Place of the first element of that sequence: 4 bytes name the encoding, 8 are the session, 4
the length, and 4 align it."""


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
            session, first = struct.unpack_from(f'{order}QQ', data, 4)
            last = first
            if self._type == _MANY_STEPS:
                (count,) = struct.unpack_from(f'{order}I', data, 12)
                if not count:
                    return None
                (first,) = struct.unpack_from(f'{order}Q', data, _FIRST)
                (last,) = struct.unpack_from(f'{order}Q', data, _FIRST + 8 * (count - 1))
        except struct.error:
            return None  # who reads the bag is told that the message is cut short
        missing = self._gaps.note(session, first, last)
        return (session, first, missing) if missing else None
