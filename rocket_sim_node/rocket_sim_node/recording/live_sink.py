# SPDX-License-Identifier: Apache-2.0
"""A recording as a stream to a viewer, which may go away and come back."""
from __future__ import annotations

import queue
import threading
import time
from urllib.parse import urlsplit

import rerun as rr

from rocket_sim_node.recording import viewer
from rocket_sim_node.recording.blueprint import blueprint
from rocket_sim_node.recording.file_sink import APPLICATION
from rocket_sim_node.recording.file_sink import Note
from rocket_sim_node.recording.file_sink import Put

DEFAULT_PORT = 9876


def parse(url: str) -> tuple[str, int]:
    """Return host and port of a viewer's URL.

    :raises ValueError: when it is none.
    """
    parts = urlsplit(url)
    if parts.scheme not in ('rerun', 'rerun+http', 'rerun+https') or not parts.hostname \
            or parts.path != '/proxy':
        raise ValueError(
            f'connect: got {url!r}, expected a URL like rerun+http://127.0.0.1:9876/proxy')
    return parts.hostname, parts.port or DEFAULT_PORT


class LiveSink:
    """Sends a recording to a viewer, from a thread of its own.

    What the viewer cannot take is dropped, flight by flight, and counted: neither the file beside
    it nor anybody else waits. Whenever the viewer is there again it gets the head of the
    recording anew and all that comes from then on.
    """

    def __init__(self, url: str, note: Note, *, room: int = 64, patience: float = 2.0) -> None:
        """Start the thread; the viewer need not be there yet.

        :param room: flights that may wait.
        :param patience: s within which the viewer must have taken one.
        :raises ValueError: when the URL is none.
        """
        self._address = parse(url)
        self._url = url
        self._note = note
        self._patience = patience
        self._queue: queue.Queue[Put | None] = queue.Queue(room)
        self._head: Put | None = None
        self._world = ''
        self._stream: rr.RecordingStream | None = None
        self._recording = f'{APPLICATION}-{time.time_ns():x}'
        self._connected = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name='live sink', daemon=True)
        self._thread.start()

    def begin(self, head: Put, world: str) -> None:
        """Set what a viewer gets first, whenever it comes, and how it shows the world.

        One that is there already, which reports of training can bring about, gets it now.
        """
        another, self._head, self._world = world != self._world, head, world

        def again(stream: rr.RecordingStream) -> None:
            if another:
                stream.send_blueprint(blueprint(live=True, world=world))
            head(stream)

        if self._stream is not None:
            self.write(again)

    def write(self, put: Put) -> None:
        """Send soon, or drop when too much waits already."""
        try:
            self._queue.put_nowait(put)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Send what waits, for a second at most."""
        try:
            self._queue.put_nowait(None)
        except queue.Full:
            return
        self._thread.join(1.0)

    def _run(self) -> None:
        while (put := self._queue.get()) is not None:
            if not self._connect():
                self.dropped += 1
                continue
            assert self._stream is not None
            put(self._stream)
            self._flush()
        if self._stream is not None:
            self._stream.disconnect()

    def _connect(self) -> bool:
        """Return whether there is a viewer, after going to meet it."""
        if self._stream is not None:
            return True
        if not viewer.reachable(*self._address):
            if self._connected or not self.dropped:
                self._note('WARN', f'no viewer at {self._url}: what it misses is dropped')
            self._connected = False
            return False
        stream = rr.RecordingStream(APPLICATION, recording_id=self._recording)
        stream.set_log_time_enabled(False)
        stream.connect_grpc(self._url, default_blueprint=blueprint(
            live=True, world=self._world))
        if self._head is not None:
            self._head(stream)
        self._stream = stream
        self._connected = True
        self._note('INFO', f'streaming to {self._url}')
        return True

    def _flush(self) -> None:
        """Wait until the viewer has it; when it does not take it, let go of the viewer."""
        assert self._stream is not None
        try:
            self._stream.flush(timeout_sec=self._patience)
        except RuntimeError as error:
            self._note('WARN', f'the viewer at {self._url} is gone: {error}')
            stream, self._stream = self._stream, None
            self._connected = False
            self.dropped += 1
            # It goes on trying for some seconds; nobody needs to wait for that.
            threading.Thread(target=stream.disconnect, daemon=True).start()
