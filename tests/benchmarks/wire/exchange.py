# SPDX-License-Identifier: Apache-2.0
"""Time of a lock-step exchange (action out, observation and reward back) and of its lower bound.

The lower bound is the time for the same number of bytes over a TCP socket between two Python
processes. Both are measured twice: on the cores that the scheduler chooses, and with each process,
including all its threads, on its own core. The simulator's world does no physics, so only the
communication is measured. All cases are measured alternately; medians are reported.
"""
from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from support.processes import Process
from support.processes import Processes

from benchmarks.wire import variants
from benchmarks.wire.agent_node import agent_node
from benchmarks.wire.tcp_floor import TcpFloor
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node.wire.client.client import Client

SIZES = (1, 64, 256, 1024, 4096)


def microseconds(once: Callable[[], Any], count: int) -> tuple[float, float]:
    """Return median and 99th percentile of the time of `count` calls, us."""
    times = np.empty(count)
    for k in range(count):
        start = time.perf_counter()
        once()
        times[k] = time.perf_counter() - start
    return float(1e6 * np.median(times)), float(1e6 * np.quantile(times, 0.99))


@contextmanager
def on_core(number: int, pid: int = 0) -> Iterator[None]:
    """Pin all threads of a process, by default this one, to one of its cores."""
    threads = [int(task.name) for task in Path(f'/proc/{pid or os.getpid()}/task').iterdir()]
    cores = {thread: os.sched_getaffinity(thread) for thread in threads}
    try:
        for thread, its in cores.items():
            os.sched_setaffinity(thread, {sorted(its)[number % len(its)]})
        yield
    finally:
        for thread, its in cores.items():
            with suppress(ProcessLookupError):  # the thread has ended meanwhile
                os.sched_setaffinity(thread, its)


@contextmanager
def still_simulator(num_envs: int) -> Iterator[tuple[Client, Process]]:
    """Yield a client in this process and a simulator without physics, which it has reset."""
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        with ExitStack() as stack:
            stack.callback(processes.end)
            node, executor = stack.enter_context(agent_node('bench_exchange', processes.domain))
            simulator = processes.start(
                'python', '-m', 'benchmarks.wire.still_world', str(num_envs))
            simulator.wait_for('waiting for an agent', 60.0)
            with Client(node, executor) as client:
                client.reset(0)
                yield client, simulator


def measure(num_envs: int, rounds: int, count: int) -> dict[str, float]:
    """Return medians over rounds for one batch size."""
    found: dict[str, list[tuple[float, float]]] = {
        'tcp': [], 'tcp_apart': [], 'dds': [], 'dds_apart': []}
    floor, apart = TcpFloor(num_envs), TcpFloor(num_envs, core=1)
    try:
        with still_simulator(num_envs) as (client, simulator):
            action = np.zeros((num_envs, 3), np.float32)

            def step() -> Any:
                return client.step(action)

            for once in (floor, apart, step):
                microseconds(once, count // 4)
            for _ in range(rounds):
                found['tcp'].append(microseconds(floor, count))
                found['dds'].append(microseconds(step, count))
                with on_core(0), on_core(1, simulator.pid):
                    found['tcp_apart'].append(microseconds(apart, count))
                    found['dds_apart'].append(microseconds(step, count))
            resent = client.resent
    finally:
        floor.close()
        apart.close()

    def ratio(ours: str, floor: str) -> float:
        return statistics.median(
            d / t for (d, _), (t, _) in zip(found[ours], found[floor], strict=True))

    return {
        **{name: statistics.median(m for m, _ in times) for name, times in found.items()},
        **{f'{name}_p99': statistics.median(p for _, p in times)
           for name, times in found.items()},
        'ratio': ratio('dds', 'tcp'), 'ratio_apart': ratio('dds_apart', 'tcp_apart'),
        'ratio_scheduled_apart': ratio('dds', 'tcp_apart'), 'resent': resent}


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench exchange', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=7, help='number of rounds')
    parser.add_argument('--count', type=int, default=400, help='exchanges per measurement')
    parser.add_argument('--sizes', type=int, nargs='+', default=list(SIZES), help='batch sizes')
    parser.add_argument('--variant', choices=list(variants.VARIANTS), help=(
        'compare with a variant instead: without checks of the senders of messages, or with step '
        'messages converted by rosidl'))
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if options.variant:
        costs = {size: variants.report(options.variant, size, options.rounds, options.count)
                 for size in options.sizes}
        if options.output:
            write_json(options.output, {options.variant: costs})
        return
    print(f'one exchange, us: medians of {options.rounds} rounds; s: as scheduled, a: a core each')
    print(f'{"":>6}{"TCP":>14}{"DDS":>14}{"DDS / TCP":>21}{"p99":>14}')
    print(f'{"batch":>6}' + f'{"s":>7}{"a":>7}' * 2 + f'{"s / s":>7}{"s / a":>7}{"a / a":>7}'
          f'{"DDS, s":>7}{"DDS, a":>7}')
    table = {}
    for size in options.sizes:
        row = table[size] = measure(size, options.rounds, options.count)
        times = ''.join(f'{row[key]:>7.0f}' for key in ('tcp', 'tcp_apart', 'dds', 'dds_apart'))
        ratios = ''.join(
            f'{row[key]:>7.1f}' for key in ('ratio', 'ratio_scheduled_apart', 'ratio_apart'))
        late = ''.join(f'{row[key]:>7.0f}' for key in ('dds_p99', 'dds_apart_p99'))
        print(f'{size:>6}{times}{ratios}{late}', flush=True)
    if options.output:
        write_json(options.output, {'exchange': table})


if __name__ == '__main__':
    main()
