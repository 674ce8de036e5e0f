# SPDX-License-Identifier: Apache-2.0
"""Memory that killed peers leave behind in a running node."""
from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest
from benchmarks.reliability.soak_samples import own_memory
from support.processes import Processes
from support.processes import wait_until

PEERS, BATCHES = 10, 4
"""peers at a time, and times; the first of them fill what is kept for the next"""
LEASE = 40.0
"""s after which all peers have forgotten a killed process; DDS waits for 20"""
LEFT = 8.0
"""KiB a peer"""
PEER = """
import time
import rclpy
from rocket_msgs.msg import Action, Episodes, Observation, Reward
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.dds.transport import prepared

with prepared(rclpy.get_rmw_implementation_identifier()):
    rclpy.init(args=[])
    node = rclpy.create_node('peer')
for kind, name in ((Observation, 'observation'), (Reward, 'reward'), (Episodes, 'episodes')):
    node.create_subscription(kind, name, print, qos.STREAM)
publisher = node.create_publisher(Action, 'action', qos.STREAM)
while not (publisher.get_subscription_count() and node.count_publishers('episodes')):
    time.sleep(0.01)
time.sleep(1.0)  # for the simulator to know as much
print('met', flush=True)
time.sleep(600.0)
"""


def test_killed_peers_leave_little_memory_behind(
        processes: Processes, make_node: Callable[..., Any], nightly: bool) -> None:
    if not nightly:
        pytest.skip('two minutes, as the dead are forgotten after 20 s: --nightly')
    node, _ = make_node()
    world = processes.start(
        sys.executable, '-m', 'rocket_sim_node.nodes.simulator', '--ros-args', '-p', 'num_envs:=8')
    world.wait_for('waiting for an agent', 30.0)
    memory = []
    for _ in range(BATCHES):
        peers = [processes.start(sys.executable, '-c', PEER) for _ in range(PEERS)]
        for peer in peers:
            peer.wait_for('met', 60.0)
        for peer in peers:
            peer.signal(signal.SIGKILL)
            peer.wait(5.0)
        wait_until(lambda: 'peer' not in node.get_node_names(), LEASE)
        time.sleep(1.0)
        memory.append(own_memory(world.pid))
    left = 1024.0 * (memory[-1] - memory[1]) / (PEERS * (BATCHES - 2))
    print(f'{left:.1f} KiB a peer; MiB after each {PEERS}: {memory}')
    assert left < LEFT
