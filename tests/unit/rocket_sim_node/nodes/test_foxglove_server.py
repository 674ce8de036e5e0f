# SPDX-License-Identifier: Apache-2.0
"""Server for Foxglove: the address that it tells."""
from __future__ import annotations

import socket

import pytest

from rocket_sim_node.nodes.bridge import foxglove_server
from rocket_sim_node.recording.sinks.rerun_program import free_port


@pytest.mark.parametrize(('host', 'told'), [
    ('127.0.0.1', '127.0.0.1'), ('0.0.0.0', socket.gethostname())])
def test_the_address_can_be_used_where_it_is_served(
        monkeypatch: pytest.MonkeyPatch, host: str, told: str) -> None:
    monkeypatch.setattr(foxglove_server, 'start_server', lambda **_: None)
    port = free_port()
    assert foxglove_server.FoxgloveServer(port, host).url == f'ws://{told}:{port}'
