# SPDX-License-Identifier: Apache-2.0
"""Time of steps between two hosts while packets are lost.

The hosts are network namespaces on this machine, joined by a virtual cable; each drops a share of
the incoming packets. All steps are compared with those of a world in the agent's process, because
a lost or repeated step would change every following bit.
"""
from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from support.network.hosts import Hosts
from support.network.hosts import missing_loss

from ppo_agent_node.evaluation.metrics import write_json

SHARES = (0.0, 0.01, 0.05)
_START = 60.0
"""time limit of a process, s"""
_STRETCH = 300
"""steps per stretch; the result is the median of the 99th percentiles of all stretches, because
other load on the machine comes in bursts"""
_FLIGHT = 300.0
"""time limit of the steps, s"""


def fly(num_envs: int, count: int, output: Path) -> int:
    """Run as the agent: write the time of each step, s, and whether all results were correct."""
    from rocket_sim_node.wire.client.client import Client
    from rocket_sim_node.wire.node.running import run
    from rocket_sim_node.worlds import make

    def body(node: Any, executor: Any) -> None:
        world = make('rocket', num_envs)
        seconds, equal = [], True
        with Client(node, executor) as client:
            equal &= np.array_equal(client.reset(1), world.reset(1))
            draw = np.random.default_rng(1)
            for _ in range(count):
                action = draw.uniform(-1, 1, (num_envs, 3)).astype(np.float32)
                begin = time.perf_counter()
                ours = client.step(action)
                seconds.append(time.perf_counter() - begin)
                theirs = world.step(action)
                equal &= all(np.array_equal(a, b) for a, b in zip(
                    ours[:4], theirs[:4], strict=True))
            steps = client.connection.step
            equal &= client.snapshot() == world.snapshot()
            write_json(output, {
                'seconds': seconds, 'steps': steps, 'equal': bool(equal),
                'resent': client.resent})

    return run('bench_loss', body, args=[])


def measure(share: float, num_envs: int, count: int, rounds: int) -> dict[str, Any]:
    """Return percentiles of the time of a step over all rounds, ms, and counts of lost packets."""
    seconds: list[float] = []
    arrived = lost = steps = resent = 0
    equal = True
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            hosts, output = Hosts(Path(folder)), Path(folder) / 'out.json'
            try:
                hosts.on(1).run_node(
                    'rocket_sim_node', 'simulator', num_envs=num_envs).wait_for(
                        'waiting for an agent', _START)
                hosts.lose(share)
                path = os.pathsep.join(filter(None, (
                    str(Path(__file__).parents[2]), os.environ.get('PYTHONPATH'))))
                agent = hosts.on(0, PYTHONPATH=path).start(
                    sys.executable, '-m', 'benchmarks.wire.loss', '--fly', str(num_envs),
                    '--count', str(count), '--output', str(output))
                assert agent.wait(_FLIGHT) == 0, hosts.logs()
                found = json.loads(output.read_text('utf-8'))
                one = hosts.lost()
            finally:
                hosts.end()
        seconds += found['seconds']
        steps, resent = steps + found['steps'], resent + found['resent']
        equal &= found['equal']
        arrived, lost = arrived + one[0], lost + one[1]
    p50, p99, p999 = (1e3 * np.percentile(seconds, [50, 99, 99.9])).tolist()
    stretches = np.array_split(seconds, max(1, len(seconds) // _STRETCH))
    typical = 1e3 * float(np.median([np.percentile(stretch, 99) for stretch in stretches]))
    return {
        'p50': p50, 'p99': p99, 'typical_p99': typical, 'p999': p999,
        'max': 1e3 * max(seconds), 'steps': steps, 'asked': len(seconds),
        'equal': equal, 'resent': resent, 'packets': arrived, 'lost': lost}


def line(share: float, f: dict[str, Any]) -> str:
    """Return a line of the table."""
    return (
        f'{share:>6.1%}{f["p50"]:>8.2f}{f["p99"]:>8.2f}{f["typical_p99"]:>11.2f}{f["p999"]:>8.2f}{f["max"]:>8.2f}'
        f'{f["steps"]:>8}{f["resent"]:>8}{f["lost"]:>7} of {f["packets"]:<8}'
        f'{"the same" if f["equal"] else "DIFFERENT"}')


HEAD = (
    f'{"loss":>6}{"p50":>8}{"p99":>8}{"its median":>11}{"p99.9":>8}{"max":>8}{"steps":>8}'
    f'{"resent":>8}{"packets lost":>15}     bits')


def main() -> int:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench loss', description=__doc__.split('\n')[0])
    parser.add_argument('--shares', type=float, nargs='+', default=list(SHARES),
                        help='shares of packets that are lost, 0 to 1')
    parser.add_argument('--num-envs', type=int, default=256, help='number of rockets')
    parser.add_argument('--count', type=int, default=3000, help='steps per round')
    parser.add_argument('--rounds', type=int, default=3, help='number of rounds')
    parser.add_argument('--fly', type=int, help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if options.fly:
        return fly(options.fly, options.count, options.output)
    if why := missing_loss():
        print(f'left out: {why}')
        return 0
    print(f'a step of {options.num_envs} rockets between two hosts, ms; {options.rounds} rounds')
    print(HEAD)
    table = {}
    for share in options.shares:
        f = table[f'{share:g}'] = measure(
            share, options.num_envs, options.count, options.rounds)
        print(line(share, f), flush=True)
    if options.output:
        write_json(options.output, {'loss': table})
    return 0


if __name__ == '__main__':
    sys.exit(main())
