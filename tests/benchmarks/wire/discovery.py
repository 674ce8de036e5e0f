# SPDX-License-Identifier: Apache-2.0
"""Time until many nodes on one machine discover each other, with and without a discovery server.

Without a server, nodes of this project probe the first 64 participants of their domain on this
machine. With ROS_DISCOVERY_SERVER they use that server and, except for the number of ports, Fast
DDS's own settings. Each node has its own participant, as it would in a separate process; several
nodes share a process here, to save memory. `dropped` counts the messages that did not fit into the
receive buffer of the server.
"""
from __future__ import annotations

import argparse
import json
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path
from typing import Any

from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node.wire.distributions import FAST_DDS_3
from rocket_sim_node.wire.distributions import fast_dds

COUNTS = (20, 60, 100, 200)
WAYS = ('by themselves', 'discovery server')
_PROCESSES = 4
_PATIENCE = 120.0
"""time limit for discovery, s"""
_LOOK = 0.5
"""s between two checks"""
_SEGMENT = re.compile(r'fastdds_(?:port)?[0-9a-f]+')
"""name of a segment, or of the segment of a port"""
_SERVER = ('42',) if fast_dds()[0] is FAST_DDS_3 else ()
"""First argument that `fastdds discovery` of Fast DDS 3 passes to its server."""


def be(count: int, first: int, total: int, patience: float) -> None:
    """Run some of the nodes; print the smallest number of nodes that one knows, and the time."""
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.utilities import get_rmw_implementation_identifier

    from rocket_sim_node.wire.dds import transport

    nodes = []
    with transport.prepared(get_rmw_implementation_identifier()):
        for number in range(first, first + count):
            context = Context()
            rclpy.init(context=context)
            nodes.append(Node(
                f'node_{number}', context=context, enable_rosout=False,
                start_parameter_services=False))
    began = time.monotonic()
    while True:
        known = min(len(set(node.get_node_names())) for node in nodes)
        seconds = time.monotonic() - began
        if known >= total or seconds > patience:
            break
        time.sleep(_LOOK)
    print(json.dumps({'known': known, 's': seconds, 'cpu_s': time.process_time()}), flush=True)
    sys.stdin.read()  # keep the nodes until all processes have finished
    os._exit(0)  # destroying the nodes one by one takes long


@contextmanager
def server() -> Iterator[str]:
    """Run a discovery server on the loopback interface; yield its address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    program = Path(sys.prefix) / 'bin' / 'fast-discovery-server'
    libraries = [Path(sys.prefix) / 'lib', *Path(sysconfig.get_path('purelib')).glob('ros_*.libs')]
    path = os.pathsep.join(map(str, filter(None, [*libraries, os.environ.get('LD_LIBRARY_PATH')])))
    process = subprocess.Popen(
        [program if program.exists() else 'fast-discovery-server', *_SERVER, '-i', '0', '-l',
         '127.0.0.1', '-p', str(port)],
        env={**os.environ, 'LD_LIBRARY_PATH': path}, stdout=subprocess.PIPE, text=True,
        start_new_session=True)
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if 'Server started' in line or 'Server is running' in line:
                break
        else:
            raise RuntimeError('the discovery server did not start')
        yield f'127.0.0.1:{port}'
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def measure(total: int, way: str, patience: float) -> dict[str, float]:
    """Return the time until all nodes knew each other, and the smallest number that one knew."""
    environment = {
        **os.environ, 'ROS_DOMAIN_ID': str(100 + secrets.randbelow(100)),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    if way == WAYS[0]:
        return _together(total, environment, patience)
    with server() as address:
        found = _together(total, {
            **environment, 'ROS_DISCOVERY_SERVER': address, 'ROS_SUPER_CLIENT': 'TRUE'}, patience)
        return {**found, 'dropped': _dropped(int(address.rpartition(':')[2]))}


def _dropped(port: int) -> int:
    """Return how many datagrams did not fit into the receive buffer of a UDP port."""
    lines = Path('/proc/net/udp').read_text('ascii').splitlines()[1:]
    return sum(int(line.split()[12]) for line in lines
               if int(line.split()[1].rpartition(':')[2], 16) == port)


def _together(total: int, environment: dict[str, str], patience: float) -> dict[str, float]:
    share = total // _PROCESSES
    processes = [subprocess.Popen(
        [sys.executable, '-m', 'benchmarks.wire.discovery', '--be', str(share),
         str(number * share), str(total), str(patience)],
        env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, text=True)  # it has only warnings of open sockets
        for number in range(_PROCESSES)]
    try:
        found: list[dict[str, float]] = []
        for process in processes:
            assert process.stdout is not None
            found.append(json.loads(process.stdout.readline()))
        return {
            'known': min(one['known'] for one in found), 's': max(one['s'] for one in found),
            'cpu_s': sum(one['cpu_s'] for one in found)}
    finally:
        for process in processes:
            process.kill()
            process.communicate()


@contextmanager
def clean_shared_memory() -> Iterator[None]:
    """Remove what processes that were killed inside have left in shared memory."""
    before = _unused_segments()
    try:
        yield
    finally:
        for segment in _unused_segments() - before:
            segment.unlink(missing_ok=True)


def _unused_segments() -> set[Path]:
    """Return the files of Fast DDS in shared memory that no running process has mapped.

    A segment's lock and semaphore have its name, with a prefix or a suffix.
    """
    used = set()
    for maps in Path('/proc').glob('[0-9]*/maps'):
        with suppress(OSError):  # it has ended
            used |= set(_SEGMENT.findall(maps.read_text(errors='replace')))
    return {path for path in Path('/dev/shm').glob('*fastdds_*')
            if not used & set(_SEGMENT.findall(path.name))}


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench discovery', description=__doc__.split('\n')[0])
    parser.add_argument('--counts', type=int, nargs='+', default=list(COUNTS),
                        help=f'numbers of nodes, multiples of {_PROCESSES}')
    parser.add_argument('--ways', nargs='+', default=list(WAYS), choices=WAYS)
    parser.add_argument('--patience', type=float, default=_PATIENCE, help='s to wait')
    parser.add_argument('--be', nargs=4, help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if options.be:
        be(*map(int, options.be[:3]), float(options.be[3]))
        return
    if wrong := [count for count in options.counts if count < 1 or count % _PROCESSES]:
        parser.error(f'--counts: got {wrong[0]}, expected multiples of {_PROCESSES}')
    print(f'{"nodes":>6}  {"way":<18}{"the last knows":>15}{"after, s":>10}{"CPU, s":>8}'
          f'{"dropped":>10}')
    rows: list[dict[str, Any]] = []
    for count in options.counts:
        for way in options.ways:
            with clean_shared_memory():
                one = measure(count, way, options.patience)
            rows.append({'nodes': count, 'way': way, **one})
            print(f'{count:>6}  {way:<18}{one["known"]:>15.0f}{one["s"]:>10.1f}'
                  f'{one["cpu_s"]:>8.1f}{one.get("dropped", ""):>10}', flush=True)
    if options.output:
        write_json(options.output, {'discovery': rows})


if __name__ == '__main__':
    main()
