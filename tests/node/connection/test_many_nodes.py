# SPDX-License-Identifier: Apache-2.0
"""More nodes in a domain than Fast DDS has ports for by default, with a discovery server."""
from __future__ import annotations

import socket
import sys
from contextlib import ExitStack

import psutil
import pytest
from support.processes import Processes

TAKEN = 110
"""participants whose ports are taken; by default Fast DDS tries about 100"""
NODE = """
import time
import rclpy
from rocket_sim_node.wire.dds.transport import prepared

with prepared(rclpy.get_rmw_implementation_identifier()):
    rclpy.init(args=[])
    node = rclpy.create_node('late')
print('made', flush=True)
time.sleep(600.0)
"""


def test_a_node_beyond_the_hundredth_has_ports(
        processes: Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DISCOVERY_SERVER', '127.0.0.1:9')
    # By DDSI-RTPS 9.6.2.3 each participant has two ports, from here on.
    first = 7400 + 250 * processes.domain + 10
    following = first + 2 * TAKEN
    with ExitStack() as taken:
        for port in range(first, following):
            one = taken.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            one.bind(('', port))
        node = processes.start(sys.executable, '-c', NODE)
        node.wait_for('made', 30.0)
        ports = {found.laddr.port for found in psutil.Process(node.pid).net_connections('udp')}
    assert {following, following + 1} <= ports, node.output()
