# SPDX-License-Identifier: Apache-2.0
"""A client of Foxglove's WebSocket protocol, which stores the received messages."""
from __future__ import annotations

import json
import struct
import time
from contextlib import ExitStack
from types import TracebackType
from typing import Any

from websockets.sync.client import connect
from websockets.typing import Subprotocol

_MESSAGE, _TIME = 1, 2


class Viewer:
    """Subscribes to topics of a server."""

    def __init__(self, url: str) -> None:
        """Connect."""
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(
            connect(url, subprotocols=[Subprotocol('foxglove.sdk.v1')]))
        self.channels: dict[str, dict[str, Any]] = {}
        """Channels that the server offers, by topic."""
        self.received: dict[str, list[tuple[int, bytes]]] = {}
        """Pairs of time, ns, and message, by topic."""
        self.time = -1
        """time of the server, ns"""
        self._topics: list[str] = []

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def subscribe(self, topic: str) -> list[tuple[int, bytes]]:
        """Subscribe to an offered topic; return the list to which messages are added."""
        self._socket.send(json.dumps({'op': 'subscribe', 'subscriptions': [
            {'id': len(self._topics), 'channelId': self.channels[topic]['id']}]}))
        self._topics.append(topic)
        return self.received.setdefault(topic, [])

    def receive(self, seconds: float = 0.1) -> None:
        """Receive messages until none has arrived for this time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                data = self._socket.recv(timeout=left)
            except TimeoutError:
                return
            end = time.monotonic() + seconds
            if isinstance(data, str):
                message = json.loads(data)
                for channel in message.get('channels', ()):
                    self.channels[channel['topic']] = channel
            elif data[0] == _TIME:
                self.time = struct.unpack_from('<Q', data, 1)[0]
            elif data[0] == _MESSAGE:
                number, stamp = struct.unpack_from('<IQ', data, 1)
                self.received[self._topics[number]].append((stamp, data[13:]))
