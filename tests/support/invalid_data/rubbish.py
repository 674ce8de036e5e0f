# SPDX-License-Identifier: Apache-2.0
"""Invalid messages on topic `action`, derived from valid ones, with their expected outcome."""
from __future__ import annotations

from typing import Any

import numpy as np
from rocket_msgs import msg

from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.messages.cdr import Codec
from support.invalid_data.fuzzing import DAMAGES
from support.invalid_data.fuzzing import damaged

N = 8
"""number of rockets of a valid action"""
CODEC = Codec(msg.Action)
NOTHING = np.zeros(0)


class Rubbish:
    """Messages of the agent in control that cause no step, with a predicted outcome."""

    def __init__(self, connection: Connection, seed: int) -> None:
        self.connection, self.rng = connection, np.random.default_rng(seed)

    def rubbish(self) -> bytes:
        """Return a message that causes no step."""
        while True:
            data = self._any()
            data += bytes(-len(data) % 4)  # pad as RTPS does, so that the same bytes arrive
            if data and self._fate(data) != 'flown':  # empty messages do not arrive
                return data

    def _any(self) -> bytes:
        rng, connection = self.rng, self.connection
        kind = int(rng.integers(4))
        if kind == 0:
            return bytes(rng.bytes(int(rng.integers(300))))
        numbers = [connection.session, connection.step, connection.agent]
        values: Any = rng.uniform(-1, 1, 3 * N)
        if kind == 1:
            good = CODEC.encode(numbers, (values, NOTHING))
            return damaged(good, rng, DAMAGES[int(rng.integers(len(DAMAGES)))])
        if kind == 2:
            place = int(rng.integers(3))
            numbers[place] = int(rng.integers(2**64, dtype=np.uint64))
            return CODEC.encode(numbers, (values, NOTHING))
        numbers[1] = max(numbers[1] - int(rng.integers(2)), 0)
        wrong = int(rng.integers(3))
        if wrong == 0:
            values[int(rng.integers(3 * N))] = rng.choice([np.nan, np.inf, -np.inf])
        elif wrong == 1:
            values = values[:int(rng.integers(3 * N))]
        return CODEC.encode(numbers, (values, rng.integers(0, 9, N) if wrong == 2 else NOTHING))

    def _fate(self, data: bytes) -> str:
        """Return the expected outcome of an action at present: flown, repeated or refused."""
        connection = self.connection
        try:
            message = CODEC.decode(data)
        except ValueError:
            return 'refused on action'
        if (message.session, message.agent) != (connection.session, connection.agent):
            return 'refused on action'
        if message.step == connection.step - 1:
            return 'repeated answers'
        good = (message.step == connection.step and not len(message.discrete)
                and len(message.continuous) == 3 * N and np.isfinite(message.continuous).all())
        return 'flown' if good else 'refused on action'
