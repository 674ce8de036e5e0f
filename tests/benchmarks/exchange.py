# SPDX-License-Identifier: Apache-2.0
"""A lock-step exchange, action out and observation and reward back, beside its floor.

The floor is the same number of bytes over a TCP socket between two Python processes, once where
the scheduler puts them, mostly on one core, and once on a core each. The simulator's world stands
still, so that what is measured is the wire. All are measured in turns; medians are reported.
"""
from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from processes import Processes

from benchmarks.tcp_floor import TcpFloor
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node.wire.client import Client
from rocket_sim_node.wire.running import make_executor

SIZES = (1, 64, 256, 1024, 4096)


def microseconds(once: Callable[[], Any], count: int) -> tuple[float, float]:
    """Return median and 99th percentile of so many calls, us."""
    times = np.empty(count)
    for k in range(count):
        start = time.perf_counter()
        once()
        times[k] = time.perf_counter() - start
    return float(1e6 * np.median(times)), float(1e6 * np.quantile(times, 0.99))


@contextmanager
def on_core(number: int) -> Iterator[None]:
    """Stay on one of the cores that there are."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(cores)[number % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def measure(num_envs: int, rounds: int, count: int) -> dict[str, float]:
    """Return medians over rounds for one size of batch."""
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        floor, apart = TcpFloor(num_envs), TcpFloor(num_envs, core=1)
        with rclpy.init(domain_id=processes.domain):
            node = rclpy.create_node('bench_exchange')
            executor = make_executor()
            executor.add_node(node)
            try:
                processes.start('python', '-m', 'benchmarks.still_world', str(num_envs)).wait_for(
                    'waiting for an agent', 60.0)
                with Client(node, executor) as client:
                    client.reset(0)
                    action = np.zeros((num_envs, 3), np.float32)
                    for once in (floor, apart, lambda: client.step(action)):
                        microseconds(once, count // 4)
                    tcp, far, dds = [], [], []
                    for _ in range(rounds):
                        tcp.append(microseconds(floor, count))
                        with on_core(0):
                            far.append(microseconds(apart, count))
                        dds.append(microseconds(lambda: client.step(action), count))
                    resent = client.resent
            finally:
                processes.end()
                floor.close()
                apart.close()
    return {
        'tcp': statistics.median(m for m, _ in tcp), 'dds': statistics.median(m for m, _ in dds),
        'tcp_apart': statistics.median(m for m, _ in far),
        'tcp_p99': statistics.median(p for _, p in tcp),
        'dds_p99': statistics.median(p for _, p in dds),
        'ratio': statistics.median(d / t for (d, _), (t, _) in zip(dds, tcp, strict=True)),
        'ratio_apart': statistics.median(
            d / t for (d, _), (t, _) in zip(dds, far, strict=True)),
        'resent': resent}


def main() -> None:
    """Print the table, write the figures."""
    parser = argparse.ArgumentParser(prog='bench exchange', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=7)
    parser.add_argument('--count', type=int, default=400, help='exchanges in a measurement')
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES))
    parser.add_argument('--output', type=Path, help='file for the figures, JSON')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(f'one exchange, us: medians of {options.rounds} rounds')
    print(f'{"":>6}{"TCP, as":>10}{"TCP, a":>10}{"":>10}{"DDS / TCP":>18}{"p99":>10}')
    print(f'{"batch":>6}{"scheduled":>10}{"core each":>10}{"DDS":>10}{"scheduled":>10}{"apart":>8}'
          f'{"DDS":>10}')
    table = {}
    for size in options.sizes:
        figures = table[size] = measure(size, options.rounds, options.count)
        print(f'{size:>6}{figures["tcp"]:>10.0f}{figures["tcp_apart"]:>10.0f}'
              f'{figures["dds"]:>10.0f}{figures["ratio"]:>10.1f}{figures["ratio_apart"]:>8.1f}'
              f'{figures["dds_p99"]:>10.0f}', flush=True)
    if options.output:
        write_json(options.output, {'exchange': table})


if __name__ == '__main__':
    main()
