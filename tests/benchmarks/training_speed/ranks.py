# SPDX-License-Identifier: Apache-2.0
"""Time of an iteration of one run by one and two ranks, within a machine and over a slow network.

Also measures its parts: flight and update by one rank, and the sum of the gradients over both. A
model of these parts is checked against two ranks, and extrapolated to more. In the model each rank
flies and learns as much as one does here, and a sum takes two passes around a ring of all ranks
(as in gloo) or through a tree (as in nccl for small tensors).
"""
from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from support.network.delayed_link import DEVICE
from support.network.hosts import Hosts
from support.network.hosts import missing
from support.training.rank_program import free_port
from support.training.rank_program import variables

from ppo_agent_node.evaluation.metrics import write_json

DELAYS = (1.0, 10.0)
"""ms, one way"""
RANKS = (1, 2, 16, 256, 4096)
_PATIENCE = 300.0
"""time limit of one measurement, s"""
_SUMS = 200
_WARM_UP = 2
"""iterations that are not counted"""


def train(path: Path, groups: int, iterations: int, part: float) -> None:
    """Run as one rank: train from scratch and write times in seconds.

    :param part: fraction of the minibatch size to train with; each rank takes an equal share.
    """
    import torch

    from ppo_agent_node.config.presets import load_preset
    from ppo_agent_node.distributed import ranks as ranks_module
    from ppo_agent_node.distributed.rendezvous import joined
    from ppo_agent_node.distributed.run_folder import open_folder
    from ppo_agent_node.training.trainer import Trainer
    from rocket_sim_node import worlds
    from rocket_sim_node.worlds.jobs import SerialFleet

    torch.set_num_threads(1)
    exchanges = itertools.count()
    finish = ranks_module.Channel._finish

    def counted(self: Any, collective: Callable[..., Any], poll: Callable[[], None]) -> None:
        next(exchanges)
        finish(self, collective, poll)

    preset = load_preset('from_scratch', 'rocket')
    config = load_preset(
        'from_scratch', 'rocket', threads=1, device='cpu', num_groups=groups, n_steps=128,
        batch_size=round(part * preset.ppo.batch_size),
        iterations=iterations + _WARM_UP + 1, selection_interval=10_000, selection_episodes=256)
    with joined() as ranks, open_folder(path / 'run', False, ranks) as folder:
        weights = sum(p.numel() for p in _networks(config))
        gradient = torch.zeros(weights)
        sums = []
        for _ in range(_SUMS if ranks.count > 1 else 0):
            before = time.perf_counter()
            ranks.main.sum_(gradient)
            sums.append(time.perf_counter() - before)
        ranks_module.Channel._finish = counted  # type: ignore[method-assign]
        Trainer(SerialFleet(worlds.make('rocket', 256)), config, folder, ranks=ranks).run()
        lines = [line for line in folder.lines() if line['iteration'] > _WARM_UP][:-1]
        if ranks.first:
            write_json(path / 'times.json', {
                'iteration': statistics.median(line['seconds'] for line in lines),
                'sum': statistics.median(sums) if sums else 0.0,
                'collectives': next(exchanges) / (iterations + _WARM_UP + 1),
                'bytes': 4 * weights})


def _networks(config: Any) -> list[Any]:
    from ppo_agent_node.ppo.learner import Learner
    from rocket_sim_node import worlds

    learner = Learner(worlds.make('rocket', 1).spec, config)
    return list(learner.policy.parameters())


def measure(
    count: int, groups: int, iterations: int, delay: float | None, part: float = 1.0,
) -> dict[str, float]:
    """Return the times of a run by `count` ranks; with a delay, each runs on its own host."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        command = [sys.executable, '-m', 'benchmarks.training_speed.ranks', '--train', str(path),
                   '--groups', str(groups), '--iterations', str(iterations), '--part', str(part)]
        if delay is None:
            _here(count, command)
        else:
            _apart(path, command, delay)
        found: dict[str, float] = json.loads((path / 'times.json').read_text('utf-8'))
        return found


def _here(count: int, command: list[str]) -> None:
    port = free_port()
    ranks = [subprocess.Popen(command, env={
        **os.environ, **variables(rank, count, port), 'OMP_NUM_THREADS': '1'})
        for rank in range(count)]
    try:
        for rank in ranks:
            if rank.wait(_PATIENCE):
                raise RuntimeError(f'a rank ended with status {rank.returncode}')
    finally:
        for rank in ranks:
            rank.kill()
            rank.wait()


def _apart(path: Path, command: list[str], delay: float) -> None:
    hosts = Hosts(path)
    try:
        hosts.delay(delay)
        ranks = [
            hosts.on(rank, **variables(rank, 2, 29_500, hosts.far_address(0)),
                     OMP_NUM_THREADS='1', GLOO_SOCKET_IFNAME=DEVICE).start(*command)
            for rank in range(2)]
        for rank in ranks:
            assert rank.wait(_PATIENCE) == 0, hosts.logs()
    finally:
        hosts.end()


def passes(ranks: int, tree: bool) -> int:
    """Return the number of sequential messages until all ranks have a sum."""
    return 2 * (math.ceil(math.log2(ranks)) if tree else ranks - 1)


def efficiency(
    work: float, collectives: float, hop: float, ranks: int, tree: bool,
) -> float:
    """Return the share of the time in which ranks fly and learn.

    :param work: time of flight and update in an iteration, s.
    :param hop: time of one message, s.
    """
    return work / (work + collectives * passes(ranks, tree) * hop)


def knee(work: float, collectives: float, hop: float, tree: bool) -> int:
    """Return the smallest number of ranks with which they wait at least as much as they work."""
    ranks = 2
    while ranks < 2**40 and efficiency(work, collectives, hop, ranks, tree) > 0.5:
        ranks *= 2
    least, most = ranks // 2, ranks
    while most - least > 1:
        middle = (least + most) // 2
        if efficiency(work, collectives, hop, middle, tree) > 0.5:
            least = middle
        else:
            most = middle
    return most


def main() -> None:
    """Print the tables and write the figures."""
    parser = argparse.ArgumentParser(prog='bench ranks', description=__doc__.split('\n')[0])
    parser.add_argument('--groups', type=int, default=4, help='groups of 256 rockets of the run')
    parser.add_argument('--iterations', type=int, default=6, help='iterations per measurement')
    parser.add_argument('--delays', type=float, nargs='*', default=list(DELAYS),
                        help='one-way delays of the network, ms')
    parser.add_argument('--rounds', type=int, default=3, help='number of rounds')
    parser.add_argument('--part', type=float, default=1.0, help=argparse.SUPPRESS)
    parser.add_argument('--train', type=Path, help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if options.train:
        train(options.train, options.groups, options.iterations, options.part)
        return
    if options.delays and (why := missing()):
        print(f'network left out: {why}')
        options.delays = []
    cases = {'one rank': (1, None), 'two ranks': (2, None), 'half': (1, None), **{
        f'two ranks, {delay:g} ms': (2, delay) for delay in options.delays}}
    found: dict[str, list[dict[str, float]]] = {name: [] for name in cases}
    for _ in range(options.rounds):
        for name, (count, delay) in cases.items():
            part = 0.5 if name == 'half' else 1.0
            found[name].append(measure(
                count, round(part * options.groups), options.iterations, delay, part))
    times = {
        name: {key: statistics.median(one[key] for one in ones) for key in ones[0]}
        for name, ones in found.items()}
    alone, work = times['one rank']['iteration'], times['half']['iteration']
    print(f'an iteration of {options.groups} groups, s: medians of {options.rounds} rounds')
    print(f'{"":<20}{"iteration":>10}{"speed-up":>10}{"waits":>6}{"a sum, ms":>11}{"model":>8}')
    rows = {}
    for name, one in times.items():
        if name == 'half':
            continue
        row: dict[str, float] = {**one, 'speed_up': alone / one['iteration']}
        if name != 'one rank':
            row['model'] = work + one['collectives'] * one['sum']
        rows[name] = row
        model_time = f'{row["model"]:.3f}' if 'model' in row else ''
        print(f'{name:<20}{row["iteration"]:>10.3f}{row["speed_up"]:>10.2f}'
              f'{row["collectives"]:>6.0f}{1000 * row["sum"]:>11.2f}{model_time:>8}', flush=True)
    print('\nmodel: share of the time in which ranks work, each with '
          f'{options.groups // 2} groups; fewest ranks at which it is less than half')
    print(f'{"":<28}' + ''.join(f'{count:>8}' for count in RANKS[1:]) + f'{"half":>10}')
    model = {}
    for name, one in rows.items():
        if name == 'one rank':
            continue
        for tree in (False, True):
            hop = one['sum'] / passes(2, tree)
            shares = [efficiency(work, one['collectives'], hop, count, tree)
                      for count in RANKS[1:]]
            least = knee(work, one['collectives'], hop, tree)
            label = f'{name}, {"tree" if tree else "ring"}'
            model[label] = {'shares': shares, 'knee': least}
            print(f'{label:<28}' + ''.join(f'{share:>8.3f}' for share in shares)
                  + f'{least:>10}')
    if options.output:
        write_json(options.output, {'ranks': {
            'groups': options.groups, 'rows': rows, 'work': work, 'model': model,
            'counts': list(RANKS[1:])}})


if __name__ == '__main__':
    main()
