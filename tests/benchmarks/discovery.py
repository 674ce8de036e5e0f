# SPDX-License-Identifier: Apache-2.0
"""Time until an agent has found its simulator among many other nodes of the same domain.

Once as the nodes discover each other by default, by probing the ports of this machine, and once by
a discovery server of Fast DDS. The others only exist: each is a participant of its own, with the
publishers and subscriptions of a simulator in a namespace of its own.
"""
from __future__ import annotations

import argparse
import os
import shutil
import signal
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier
from rocket_msgs import msg
from support.processes import Processes
from support.processes import ros_args

from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.dds.transport import prepared
from rocket_sim_node.wire.node.running import make_executor
from rocket_sim_node.wire.node.waiting import WireTimeout

SIZES = (0, 32, 100, 200)
WAYS = ('ports', 'server')
_TOGETHER = 25
"""participants of the crowd in a process"""
_PORT = 11811
_PATIENCE = 30.0


@contextmanager
def participant(name: str, domain: int, namespace: str = '') -> Iterator[tuple[Node, Executor]]:
    """Yield a node in a context of its own, with the profile of our nodes."""
    context = Context()
    with prepared(get_rmw_implementation_identifier()):
        rclpy.init(context=context, domain_id=domain)
        node = Node(name, context=context, namespace=namespace)
    executor = make_executor(context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.remove_node(node)
        node.destroy_node()
        rclpy.shutdown(context=context)


def crowd(first: int, count: int, domain: int) -> None:
    """Make so many participants, and keep them until a signal comes."""
    kept = []
    for number in range(first, first + count):
        context = Context()
        with prepared(get_rmw_implementation_identifier()):
            rclpy.init(context=context, domain_id=domain)
            node = Node('simulator', context=context, namespace=f'/crowd_{number}')
        for kind, topic, profile in (
                (msg.World, 'world', qos.WORLD), (msg.Observation, 'observation', qos.STREAM),
                (msg.Reward, 'reward', qos.STREAM), (msg.Episodes, 'episodes', qos.EVENTS),
                (msg.RocketState, 'state', qos.EVENTS)):
            node.create_publisher(kind, topic, profile)
        node.create_subscription(msg.Action, 'action', lambda message: None, qos.STREAM)
        kept.append(node)
    print('ready', flush=True)
    signal.pause()


def processor_seconds(processes: list[int]) -> float:
    """Return the processor time that processes have used so far, s."""
    tick, total = os.sysconf('SC_CLK_TCK'), 0.0
    for pid in processes:
        fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
        total += (int(fields[11]) + int(fields[12])) / tick
    return total


def measure(size: int, way: str, rounds: int) -> dict[str, Any]:
    """Return the times with a crowd of so many participants, s; None where nothing was found."""
    os.environ.pop('ROS_DISCOVERY_SERVER', None)
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        try:
            if way == 'server':
                server = shutil.which('fast-discovery-server')
                assert server, 'fast-discovery-server is not installed'
                processes.start(server, '-i', '0', '-l', '127.0.0.1', '-p', str(_PORT))
                os.environ['ROS_DISCOVERY_SERVER'] = f'127.0.0.1:{_PORT}'
                time.sleep(1.0)
            began = time.monotonic()
            others = [
                processes.start(
                    'python', '-m', 'benchmarks.discovery', '--crowd', str(first),
                    str(min(_TOGETHER, size - first)), str(processes.domain))
                for first in range(0, size, _TOGETHER)]
            for other in others:
                other.wait_for('ready', 300.0)
            made = time.monotonic() - began
            time.sleep(5.0)
            pids = [other.pid for other in others]
            before, since = processor_seconds(pids), time.monotonic()
            time.sleep(5.0)
            idle = (processor_seconds(pids) - before) / (time.monotonic() - since)
            simulator = processes.start(
                'ros2', 'run', 'rocket_sim_node', 'simulator',
                *ros_args(('__ns:=/mine',), num_envs=1))
            simulator.wait_for('waiting for an agent', 120.0)
            found = [found_after(processes.domain) for _ in range(rounds)]
        finally:
            processes.end()
            os.environ.pop('ROS_DISCOVERY_SERVER', None)
    return {'others': size, 'way': way, 'seconds': found, 'seconds_to_make': made,
            'cores_idle': idle}


def found_after(domain: int) -> float | None:
    """Return after how long a new agent has the simulator's first answer, s; None: not in time."""
    began = time.monotonic()
    with participant('bench_discovery', domain, '/mine') as (node, executor):
        try:
            with Client(node, executor, patience=_PATIENCE) as client:
                client.reset(0)
                client.step(np.zeros((1, 3), np.float32))
                return time.monotonic() - began
        except WireTimeout:
            return None


def text(row: dict[str, Any]) -> str:
    """Return a line of the table."""
    times = [one for one in row['seconds'] if one is not None]
    found = (f'{statistics.median(times):6.2f} s ({min(times):.2f} to {max(times):.2f})'
             if times else f'not found in {_PATIENCE:.0f} s')
    missed = f', {len(row["seconds"]) - len(times)} of {len(row["seconds"])} not found' if (
        times and len(times) < len(row['seconds'])) else ''
    return (f'{row["others"]:>6}  {row["way"]:<8}{found}{missed}; idle they use '
            f'{row["cores_idle"]:.2f} cores, started in {row["seconds_to_make"]:.1f} s')


def main() -> None:
    """Print the table, write the figures."""
    parser = argparse.ArgumentParser(prog='bench discovery', description=__doc__.split('\n')[0])
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES), help='other nodes')
    parser.add_argument('--ways', nargs='+', default=list(WAYS), choices=WAYS, help=(
        'ports: as by default; server: by a discovery server'))
    parser.add_argument('--rounds', type=int, default=5, help='agents, one after the other')
    parser.add_argument('--crowd', type=int, nargs=3, help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if options.crowd:
        crowd(*options.crowd)
        return
    rows = []
    for size in options.sizes:
        for way in options.ways:
            rows.append(measure(size, way, options.rounds))
            print(text(rows[-1]), flush=True)
    if options.output:
        write_json(options.output, {'discovery': rows})


if __name__ == '__main__':
    main()
