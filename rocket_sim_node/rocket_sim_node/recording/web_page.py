# SPDX-License-Identifier: Apache-2.0
"""A recording as a web page, for browsers on this machine."""
from __future__ import annotations

from urllib.parse import quote

from rocket_sim_node.recording import viewer
from rocket_sim_node.recording.viewer import LOCAL


class WebPage:
    """The Rerun program as a server, bound to this machine, for any number of browsers.

    It keeps what it got, so that a browser that comes late sees all of it.
    """

    def __init__(self, port: int, memory: str = '512MiB') -> None:
        """Start it and wait until it listens.

        :param port: of the page; the data flows through another one.
        :param memory: kept for browsers that come late; older data makes room.
        :raises ViewerError: when it cannot be started, for example because the port is taken.
        """
        if viewer.reachable(LOCAL, port):
            raise viewer.ViewerError(f'web_port: {port} is taken by another program')
        data = viewer.free_port()
        self.url = f'rerun+http://{LOCAL}:{data}/proxy'
        self.page = f'http://{LOCAL}:{port}/?url={quote(self.url, safe="")}'
        self._program = viewer.Program(
            '--serve-web', '--bind', LOCAL, '--port', str(data), '--web-viewer-port', str(port),
            '--server-memory-limit', memory)
        try:
            self._program.wait_for(
                lambda: viewer.reachable(LOCAL, port) and viewer.reachable(LOCAL, data),
                'the web viewer', 20.0)
        except viewer.ViewerError:
            self._program.stop()
            raise

    def close(self) -> None:
        """Stop it."""
        self._program.stop()
