# SPDX-License-Identifier: Apache-2.0
"""Programs for two hosts: an intruder that tries to see and control nodes, and a pilot.

Arguments: `intruder SECONDS PORT...` or `pilot FILE`. Each prints its results as JSON in its last
line.
"""
from __future__ import annotations

import json
import os
import socket
import sys
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

N = 4
_STEPS = 20


def intrude(seconds: float) -> dict[str, Any]:
    """Look for nodes and topics, and try to take control and to send actions in any case."""
    import rclpy
    from rocket_msgs import msg
    from rocket_msgs import srv

    from rocket_sim_node.wire.dds import qos
    from rocket_sim_node.wire.distributions import initialised

    with initialised():
        node = rclpy.create_node('intruder')
        publisher = node.create_publisher(msg.Action, 'action', qos.STREAM)
        heard: list[Any] = []
        subscriptions = [
            node.create_subscription(kind, name, heard.append, profile)
            for kind, name, profile in (
                (msg.World, 'world', qos.WORLD), (msg.Observation, 'observation', qos.STREAM))]
        reset = node.create_client(srv.Reset, 'simulator/reset')
        answers, nodes, publishers = [], set(), 0
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            publisher.publish(msg.Action(agent=1, continuous=[0.0] * (3 * N)))
            future = reset.call_async(srv.Reset.Request(agent=1, seed=5))
            rclpy.spin_until_future_complete(node, future, timeout_sec=0.2)
            if future.done():
                answers.append(future.result().code)
            nodes |= set(node.get_node_names()) - {'intruder'}
            publishers = max(publishers, node.count_publishers('/observation'))
        assert subscriptions
    return {
        'nodes': sorted(nodes), 'publishers': publishers, 'heard': len(heard),
        'answers': len(answers)}


def knock(host: str, ports: Collection[int]) -> int:
    """Send invalid RTPS packets to UDP ports of a host; return their number."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for port in ports:
            sender.sendto(b'RTPS' + os.urandom(60), (host, port))
    return len(ports)


def pilot(go: Path) -> int:
    """Fly, wait for a file, fly on; print whether all results equal those of a world here."""
    import numpy as np

    from rocket_sim_node.wire.client.client import Client
    from rocket_sim_node.wire.node.running import run
    from rocket_sim_node.worlds import make

    def body(node: Any, executor: Any) -> None:
        world = make('rocket', N)
        actions = np.random.default_rng(3).uniform(-1, 1, (2 * _STEPS, N, 3)).astype(np.float32)
        with Client(node, executor) as client:
            equal = np.array_equal(client.reset(3), world.reset(3))
            for number, action in enumerate(actions):
                if number == _STEPS:
                    print('flying', flush=True)
                    client.waiter.until(go.exists, 60.0)
                equal &= np.array_equal(client.step(action)[0], world.step(action)[0])
            equal &= client.snapshot() == world.snapshot()
            print(json.dumps({'steps': client.connection.step, 'equal': bool(equal)}), flush=True)

    return run('pilot', body, args=[])


if __name__ == '__main__':
    if sys.argv[1] == 'pilot':
        sys.exit(pilot(Path(sys.argv[2])))
    first = 7400 + 250 * int(os.environ['ROS_DOMAIN_ID'])
    if peers := os.environ.get('ROS_STATIC_PEERS'):
        knock(peers, {*range(first, first + 250), *map(int, sys.argv[3:])})
    print(json.dumps(intrude(float(sys.argv[2]))), flush=True)
