# SPDX-License-Identifier: Apache-2.0
"""Sink that streams a recording to a viewer, which may connect late, disconnect and return."""
from __future__ import annotations

import queue
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

import rerun as rr

from rocket_sim_node.recording.scene.blueprint import blueprint
from rocket_sim_node.recording.sinks import increments
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.base import APPLICATION
from rocket_sim_node.recording.sinks.base import Look
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.sinks.destinations import Note
from rocket_sim_node.recording.sinks.destinations import viewer_address
from rocket_sim_node.recording.sinks.increments import Increments

KEPT_FLIGHTS = 64
KEPT_REPORTS = 2000
"""Number of flights, and of other entries, that are kept for a viewer that connects late."""
_LOOK_OUT = 1.0
"""Seconds between checks for a viewer or its presence, while nothing is sent."""


@dataclass(frozen=True)
class _Item:
    """Something to send: an entry of the recording, a flight, or part of one."""

    put: Put
    flight: bool = False
    until: int = increments.FOR_EVER
    kept: bool = True
    """Whether it is kept for viewers that connect later."""


class LiveSink:
    """Sends a recording to a viewer, from a thread of its own.

    Nothing else waits for the viewer. Whenever one connects, late or again, it receives the start
    of the recording, the recent flights, and everything from then on. If a viewer is too slow,
    whole flights are dropped and counted.
    """

    live = True

    def __init__(self, url: str, note: Note, *, room: int = 64, patience: float = 2.0) -> None:
        """Start the thread; the viewer may connect later.

        :param room: maximum number of waiting entries.
        :param patience: time limit, s, for the viewer to receive one.
        :raises ValueError: when the URL is invalid.
        """
        self._address = viewer_address(url)
        self._url = url
        self._note = note
        self._patience = patience
        self._queue: queue.Queue[_Item | None] = queue.Queue(room)
        self._head: Put | None = None
        self._look = Look()
        self._flights: deque[_Item] = deque(maxlen=KEPT_FLIGHTS)
        self._reports: deque[_Item] = deque(maxlen=KEPT_REPORTS)
        self._stream: rr.RecordingStream | None = None
        self._unsent: Increments | None = None
        self._farewell: threading.Thread | None = None
        self._next_try = 0.0
        self._told_missing = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name='live sink', daemon=True)
        self._thread.start()

    def begin(self, head: Put, look: Look) -> None:
        """Set what a viewer receives first when it connects, and its layout.

        A connected viewer receives it now.
        """
        another, self._head, self._look = look != self._look, head, look

        def again(stream: rr.RecordingStream) -> None:
            if another:
                stream.send_blueprint(_layout(look))
            head(stream)

        self._next_try = 0.0
        self._put(_Item(again, kept=False))

    def write(self, put: Put) -> None:
        """Queue an entry, or drop it when the queue is full."""
        self._put(_Item(put))

    def write_trajectory(self, put: Put) -> bool:
        """Send the unsent part of an ended flight; return True."""
        self._put(_Item(put, flight=True))
        return True

    def under_way(self, put: Put, until: int) -> None:
        """Send the unsent part of a flight in progress, if nothing else is waiting.

        Anything omitted is sent with the next part, or with the ended flight.
        """
        if self._queue.empty():
            self._put(_Item(put, flight=True, until=until, kept=False))

    def close(self) -> None:
        """Send waiting entries, for at most a second."""
        with suppress(queue.Full):
            self._queue.put(None, timeout=1.0)
            self._thread.join(1.0)
        if self.dropped:
            self._note('WARN', f'the viewer at {self._url} was too slow: it did not receive '
                               f'{self.dropped} flights or parts of them')

    def _put(self, item: _Item) -> None:
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.dropped += 1

    def _run(self) -> None:
        going = True
        while going:
            try:
                going = self._turn()
            except Exception as error:  # noqa: BLE001 - the thread must survive any error
                self._complain(error)
        if self._stream is not None:
            self._stream.disconnect()

    def _turn(self) -> bool:
        """Send the next waiting entry, or check for the viewer; return whether to continue."""
        try:
            item = self._queue.get(timeout=_LOOK_OUT)
        except queue.Empty:
            self._flush()
            self._connect()
            return True
        if item is None:
            return False
        if item.kept:
            (self._flights if item.flight else self._reports).append(item)
        if self._stream is not None:
            self._send(item)
        else:
            self._connect()  # also sends this item
        return True

    def _connect(self) -> None:
        """Connect to a viewer, and send what it has missed."""
        now = time.monotonic()
        if self._stream is not None or self._head is None or now < self._next_try:
            return
        self._next_try = now + _LOOK_OUT
        if self._farewell is not None and self._farewell.is_alive():
            return
        if not rerun_program.reachable(*self._address):
            if not self._told_missing:
                self._told_missing = True
                self._note('WARN', f'no viewer at {self._url}: one that connects later receives '
                                   f'the last {KEPT_FLIGHTS} flights')
            return
        # A new recording for each connection: a viewer that was only slow has some data already.
        stream = rr.RecordingStream(
            APPLICATION, recording_id=f'{APPLICATION}-{time.time_ns():x}')
        stream.set_log_time_enabled(False)
        stream.connect_grpc(self._url, default_blueprint=_layout(self._look))
        self._stream = stream
        self._unsent = Increments(stream)
        self._told_missing = False
        self._note('INFO', f'streaming to {self._url}')
        self._head(stream)
        for kept in (self._reports, self._flights):
            for item in list(kept):
                try:
                    self._send(item)
                except Exception as error:  # noqa: BLE001 - the other entries must still be shown
                    kept.remove(item)
                    self._complain(error)

    def _complain(self, error: Exception) -> None:
        self._note('ERROR', f'not shown by the viewer at {self._url}: {error}')

    def _send(self, item: _Item) -> None:
        """Send an item and wait until the viewer has received it; disconnect if it does not."""
        if self._stream is None or self._unsent is None:
            return
        if item.flight:
            self._unsent.until = item.until
            item.put(cast('rr.RecordingStream', self._unsent))
        else:
            item.put(self._stream)
        self._flush()
        if self._stream is None:
            self.dropped += 1

    def _flush(self) -> None:
        """Wait until a connected viewer has received everything; disconnect if it is dead."""
        if self._stream is None:
            return
        try:
            self._stream.flush(timeout_sec=self._patience)
        except RuntimeError as error:
            self._note('WARN', f'the viewer at {self._url} has disconnected: {error}')
            stream, self._stream = self._stream, None
            # It keeps trying as long as the connection of a stopped viewer exists. Nothing waits
            # for that, but no other stream can be opened meanwhile.
            self._farewell = threading.Thread(target=stream.disconnect, daemon=True)
            self._farewell.start()


def _layout(look: Look) -> rr.blueprint.Blueprint:
    return blueprint(live=True, training=look.training, unusual=look.unusual, world=look.world)
