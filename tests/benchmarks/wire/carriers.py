# SPDX-License-Identifier: Apache-2.0
"""Time of a lock-step exchange over each transport of Fast DDS within one machine.

`ours` is the profile that the nodes load: UDP. The others replace it for both ends. A process
can load only one profile, so each measurement uses two new processes; the transports are measured
alternately. Each figure is a ratio to `ours` of the same turn.
"""
from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.wire.exchange import microseconds
from benchmarks.wire.exchange import still_simulator
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node.wire.distributions import fast_dds

SIZES = (1, 256, 1024, 4096)
OURS = 'ours'
_PATIENCE = 60.0
"""time limit of one measurement, s"""
_TRANSPORT = '<userTransports>\n          <transport_id>loopback</transport_id>'
_LARGE_SOCKET = '<receiveBufferSize>4194304</receiveBufferSize>'
_USUAL_SOCKET = (
    '<sendBufferSize>212992</sendBufferSize><receiveBufferSize>212992</receiveBufferSize>')
"""What Linux allows by default (net.core.rmem_max)"""
_TCP = """<transport_descriptor>
        <transport_id>tcp</transport_id>
        <type>TCPv4</type>
        <listening_ports><port>0</port></listening_ports>
        <calculate_crc>false</calculate_crc>
        <check_crc>false</check_crc>
        <enable_tcp_nodelay>true</enable_tcp_nodelay>
        <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
      </transport_descriptor>
    </transport_descriptors>"""
_BY_TCP = """<defaultUnicastLocatorList>
          <locator><tcpv4><address>127.0.0.1</address></tcpv4></locator>
        </defaultUnicastLocatorList>
        <userTransports><transport_id>tcp</transport_id>"""


def carriers(folder: Path) -> dict[str, dict[str, str]]:
    """Return the environment variables of each transport, by name; write profiles to a folder."""
    version, _ = fast_dds()
    text = (version.profiles / 'machine.xml').read_text('utf-8')
    head, tag, rest = text.partition(_TRANSPORT)
    assert tag
    assert all(part in text for part in (_LARGE_SOCKET, '</transport_descriptors>'))
    profiles = {
        'UDP, sockets of 208 KiB': text.replace(_LARGE_SOCKET, _USUAL_SOCKET),
        'TCP': f'{head.replace("</transport_descriptors>", _TCP)}{_BY_TCP}{rest}'}
    found: dict[str, dict[str, str]] = {OURS: {}}
    for number, (name, profile) in enumerate(profiles.items()):
        path = folder / f'{number}.xml'
        path.write_text(profile)
        found[name] = {version.variables[0]: str(path), 'SKIP_DEFAULT_XML_FILE': '1'}
    for name in ('UDPv4', 'SHM', 'DEFAULT', 'LARGE_DATA'):
        found[f'Fast DDS: {name}'] = {'FASTDDS_BUILTIN_TRANSPORTS': name}
    return found


def measure(num_envs: int, count: int, warm_up: int) -> dict[str, float]:
    """Return median and 99th percentile of an exchange, us, and the number of messages re-sent."""
    with still_simulator(num_envs) as (client, _):
        action = np.zeros((num_envs, 3), np.float32)
        microseconds(lambda: client.step(action), warm_up)
        before = client.resent
        median, late = microseconds(lambda: client.step(action), count)
        return {'us': median, 'p99': late, 'resent': client.resent - before}


def in_own_process(
    environment: Mapping[str, str], size: int, count: int,
) -> dict[str, float] | None:
    """Measure in a process of its own; return None if it fails."""
    child = subprocess.Popen(
        [sys.executable, '-m', 'benchmarks.wire.carriers', '--one', str(size), '--count',
         str(count)],
        env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True)
    try:
        text, _ = child.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        child.send_signal(signal.SIGINT)  # so that it ends its simulator
        child.communicate()
        return None
    if child.returncode:
        return None
    figures: dict[str, float] = json.loads(text.splitlines()[-1])
    return figures


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench carriers', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=5, help='turns of each carrier')
    parser.add_argument('--count', type=int, default=1000, help='exchanges per turn')
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES), help='batch sizes')
    parser.add_argument('--only', nargs='+', help='names of carriers besides ours')
    parser.add_argument('--one', type=int, help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if options.one:
        print(json.dumps(measure(options.one, options.count, options.count // 4)))
        return
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        ways = carriers(Path(folder))
        if options.only:
            ways = {name: ways[name] for name in (OURS, *options.only)}
        for size in options.sizes:
            turns = [{name: in_own_process(environment, size, options.count)
                      for name, environment in ways.items()} for _ in range(options.rounds)]
            for name in ways:
                done = [(turn[name], turn[OURS]) for turn in turns if turn[name] and turn[OURS]]
                row: dict[str, Any] = {
                    'size': size, 'carrier': name, 'failed': options.rounds - len(done)}
                if done:
                    ratios = sorted(one['us'] / ours['us'] for one, ours in done)  # type: ignore[index]
                    row |= {
                        'us': statistics.median(one['us'] for one, _ in done),  # type: ignore[index]
                        'ratio': statistics.median(ratios), 'low': ratios[0], 'high': ratios[-1],
                        'resent': sum(one['resent'] for one, _ in done)}  # type: ignore[index]
                rows.append(row)
                print(text(row), flush=True)
    if options.output:
        write_json(options.output, {'carriers': rows})


def text(row: Mapping[str, Any]) -> str:
    """Return a line of the table."""
    begin = f'{row["size"]:>6}  {row["carrier"]:<24}'
    failed = f'  failed in {row["failed"]} turns' if row['failed'] else ''
    if 'us' not in row:
        return begin + failed
    return (f'{begin}{row["us"]:8.0f} us  {row["ratio"]:6.2f} x ours '
            f'({row["low"]:.2f} to {row["high"]:.2f})  sent again {row["resent"]:.0f}{failed}')


if __name__ == '__main__':
    main()
