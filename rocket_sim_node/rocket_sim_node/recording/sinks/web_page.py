# SPDX-License-Identifier: Apache-2.0
"""A recording as a web page, for browsers on this machine unless told otherwise."""
from __future__ import annotations

import ipaddress
import socket
from urllib.parse import quote

from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.rerun_program import LOCAL

INVITATION = 'watch it in a browser: '
"""How the line begins that tells people of the page."""


class WebPage:
    """The Rerun program as a server for any number of browsers.

    It keeps what it got, so that a browser that comes late sees all of it.
    """

    def __init__(self, port: int, host: str = LOCAL, memory: str = '512MiB') -> None:
        """Start it and wait until it listens.

        :param port: of the page; the data flows through another one.
        :param host: address of this machine that it listens at; 0.0.0.0: at all of them.
        :param memory: kept for browsers that come late; older data makes room.
        :raises ValueError: when `host` is no address.
        :raises ViewerError: when it cannot be started, for example because the port is taken.
        """
        try:
            address = ipaddress.IPv4Address(host)
        except ValueError:
            raise ValueError(
                f'web_host: got {host!r}, expected an IPv4 address such as {LOCAL}') from None
        near = LOCAL if address.is_unspecified else host
        far = socket.gethostname() if address.is_unspecified else host
        if rerun_program.reachable(near, port):
            raise rerun_program.ViewerError(f'web_port: {port} is taken by another program')
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
        """Stop it."""
        self._program.stop()
