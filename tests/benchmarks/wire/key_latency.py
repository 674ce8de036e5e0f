# SPDX-License-Identifier: Apache-2.0
"""Time from a key press to the first state that shows it.

A simulator runs in real time and the keyboard pilot in a pseudo-terminal. This process alternately
presses the keys for full throttle and engine off, and subscribes to `state`.
"""
from __future__ import annotations

import argparse
import random
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs import msg
from support.processes import Processes
from support.users.pseudo_terminal import PseudoTerminal

from benchmarks.wire.agent_node import agent_node
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node.wire.dds import qos

_LOST = 2.0
"""s after which a press is counted as lost"""
_PAUSE = 0.1
"""minimum time between two presses, s"""


def measure(
    presses: int, processes: Processes, terminal: PseudoTerminal,
) -> tuple[list[float], int]:
    """Return the latencies, s, and the number of presses without an effect."""
    processes.run_node('rocket_sim_node', 'simulator', num_envs=1, mode='realtime')
    with agent_node('looker', processes.domain) as (node, executor):
        return _press(presses, processes, terminal, node, executor)


def _press(
    presses: int, processes: Processes, terminal: PseudoTerminal, node: Node, executor: Executor,
) -> tuple[list[float], int]:
    """Press keys; return the results of `measure`."""
    seen = {'throttle': -1.0, 'fuel': 0.0, 'height': 0.0, 'at': 0.0}

    def look(message: Any) -> None:
        seen.update(throttle=message.throttle[-1], fuel=message.fuel[-1],
                    height=message.position[-1], at=time.perf_counter())

    node.create_subscription(msg.RocketState, 'state', look, qos.EVENTS)
    terminal.fly(processes.env, repeat_delay=0.05)
    phase = random.Random(0)
    latencies: list[float] = []
    missed = 0
    on = False
    terminal.press(b'r')
    while len(latencies) < presses:
        end = time.perf_counter() + _PAUSE + phase.random() * 0.05
        while time.perf_counter() < end:
            executor.spin_once(timeout_sec=0.005)
        if (time.perf_counter() - seen['at'] > 0.5 or seen['height'] < 20.0
                or seen['fuel'] < 200.0 or seen['throttle'] != on):
            terminal.press(b'r')
            on = False
            time.sleep(0.5)
            continue
        on = not on
        pressed = time.perf_counter()
        terminal.press(b'z' if on else b'x')
        while seen['throttle'] != on and time.perf_counter() < pressed + _LOST:
            executor.spin_once(timeout_sec=0.005)
        if seen['throttle'] == on:
            latencies.append(seen['at'] - pressed)
        else:
            missed += 1
    terminal.press(b'q')
    return latencies, missed


def main() -> None:
    """Print median, 95th percentile and maximum."""
    parser = argparse.ArgumentParser(prog='bench key_latency', description=__doc__.split('\n')[0])
    parser.add_argument('--presses', type=int, default=200, help='number of key presses')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        processes, terminal = Processes(Path(folder)), PseudoTerminal()
        try:
            latencies, missed = measure(options.presses, processes, terminal)
        finally:
            terminal.close()
            processes.end()
    figures = np.percentile(latencies, (50, 95, 100)) * 1e3
    print('{} presses: median {:.1f} ms, 95 % within {:.1f} ms, at most {:.1f} ms; '
          '{} without an answer in {:g} s'.format(len(latencies), *figures, missed, _LOST))
    if options.output:
        names = ('median_ms', 'p95_ms', 'most_ms')
        write_json(options.output, {
            **dict(zip(names, figures.tolist(), strict=True)),
            'missed': missed, 'latencies_ms': [1e3 * latency for latency in latencies]})


if __name__ == '__main__':
    main()
