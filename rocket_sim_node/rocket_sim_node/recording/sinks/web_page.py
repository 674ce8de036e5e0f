# SPDX-License-Identifier: Apache-2.0
"""Web server for a recording, for browsers on this machine by default."""
from __future__ import annotations

from urllib.parse import quote

from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.destinations import check_page
from rocket_sim_node.recording.sinks.destinations import far_host
from rocket_sim_node.recording.sinks.destinations import page_address
from rocket_sim_node.recording.sinks.rerun_program import LOCAL

INVITATION = 'watch it in a browser: '
"""Start of the log line that announces the page."""


class WebPage:
    """The Rerun program as a server for any number of browsers.

    It keeps the data it received, so that a browser that connects late sees all of it.
    """

    def __init__(self, port: int, host: str = LOCAL, memory: str = '512MiB') -> None:
        """Start the server and wait until it listens.

        :param port: of the page; the data uses another port.
        :param host: address of this machine to listen on; 0.0.0.0 for all.
        :param memory: limit of the data kept for late browsers; the oldest is dropped.
        :raises ValueError: when `host` is no address of this machine, or the port is in use.
        :raises ViewerError: when it cannot be started.
        """
        address = page_address(host)
        check_page(port, host)
        near = LOCAL if address.is_unspecified else host
        far = far_host(host)
        data = rerun_program.free_port()
        self.url = f'rerun+http://{near}:{data}/proxy'
        seen = quote(f'rerun+http://{far}:{data}/proxy', safe='')
        self.page = f'http://{far}:{port}/?url={seen}'
        self._program = rerun_program.Program(
            '--serve-web', '--bind', host, '--port', str(data), '--web-viewer-port', str(port),
            '--server-memory-limit', memory)
        try:
            self._program.wait_for(
                lambda: all(rerun_program.reachable(near, each) for each in (port, data)),
                'the web viewer', 20.0)
        except rerun_program.ViewerError:
            self._program.stop()
            raise

    def close(self) -> None:
        """Stop the server."""
        self._program.stop()
