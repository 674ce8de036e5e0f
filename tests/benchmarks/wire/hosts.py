# SPDX-License-Identifier: Apache-2.0
"""Time of a lock-step exchange with a simulator on another host, and with one on the same host.

The hosts are network namespaces on this machine, joined by a virtual cable. This measures the
network stack; a real cable adds its own time. In both cases messages are acknowledged, as they
always are if peers beyond the machine may be discovered.
"""
from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np
from support.network.hosts import Hosts
from support.network.hosts import missing

from ppo_agent_node.evaluation.metrics import write_json

SIZES = (1, 256, 1024)
_START = 60.0
"""time limit of a process, s"""


def fly(num_envs: int, count: int, output: Path) -> None:
    """Run as the agent: write median and 99th percentile of an exchange, us."""
    from benchmarks.wire.agent_node import agent_node
    from benchmarks.wire.exchange import microseconds
    from rocket_sim_node.wire.client.client import Client

    with agent_node('bench_hosts') as (node, executor), Client(node, executor) as client:
        client.reset(0)
        action = np.zeros((num_envs, 3), np.float32)
        microseconds(lambda: client.step(action), count // 4)
        write_json(output, dict(zip(
            ('median', 'p99'), microseconds(lambda: client.step(action), count), strict=True)))


def measure(num_envs: int, count: int, rounds: int) -> dict[str, float]:
    """Return medians over rounds: within a host and between hosts."""
    found: dict[str, list[dict[str, float]]] = {'within': [], 'between': []}
    for _ in range(rounds):
        for name, host in (('within', 0), ('between', 1)):
            with tempfile.TemporaryDirectory() as folder:
                hosts, output = Hosts(Path(folder)), Path(folder) / 'out.json'
                try:
                    hosts.on(host).start(
                        'python', '-m', 'benchmarks.wire.still_world', str(num_envs)).wait_for(
                            'waiting for an agent', _START)
                    agent = hosts.on(0).start(
                        sys.executable, '-m', 'benchmarks.wire.hosts', '--fly', str(num_envs),
                        '--count', str(count), '--output', str(output))
                    assert agent.wait(_START) == 0, hosts.logs()
                    found[name].append(json.loads(output.read_text('utf-8')))
                finally:
                    hosts.end()
    figures = {
        f'{name}_{key}': statistics.median(one[key] for one in ones)
        for name, ones in found.items() for key in ('median', 'p99')}
    return {**figures, 'ratio': figures['between_median'] / figures['within_median']}


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench hosts', description=__doc__.split('\n')[0])
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES), help='batch sizes')
    parser.add_argument('--count', type=int, default=1000, help='exchanges per measurement')
    parser.add_argument('--rounds', type=int, default=3, help='number of rounds')
    parser.add_argument('--fly', type=int, help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if options.fly:
        fly(options.fly, options.count, options.output)
        return
    if why := missing():
        print(f'left out: {why}')
        return
    print(f'one exchange, us: medians of {options.rounds} rounds')
    print(f'{"batch":>6}{"one host":>10}{"two hosts":>11}{"ratio":>7}{"p99":>8}{"p99":>8}')
    table = {}
    for size in options.sizes:
        f = table[size] = measure(size, options.count, options.rounds)
        print(f'{size:>6}{f["within_median"]:>10.0f}{f["between_median"]:>11.0f}'
              f'{f["ratio"]:>7.2f}{f["within_p99"]:>8.0f}{f["between_p99"]:>8.0f}', flush=True)
    if options.output:
        write_json(options.output, {'hosts': table})


if __name__ == '__main__':
    main()
