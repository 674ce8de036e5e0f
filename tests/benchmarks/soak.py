# SPDX-License-Identifier: Apache-2.0
"""A long training among kills: whether memory, open files, /dev/shm and steps/s stay flat.

Two simulators, an agent that trains in both, and a recorder for each run as processes of their
own. About once a minute something happens to one of them: `kill -9` and a new one in its place, or
a stop for a few seconds. Every few seconds each is looked at. At the end each figure has its slope
an hour with a 95 % interval (see soak_slopes). It is flat when the interval holds zero, or when
the slope is below 1 % of the mean.

Steps/s are those of spells of 10 s of training during which nothing happened, nor shortly before.
Steps per second of processor time, of agent and simulators, are what other load on the machine
disturbs less.
"""
from __future__ import annotations

import argparse
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import soak_plot
from benchmarks.soak_nodes import NODES
from benchmarks.soak_nodes import Nodes
from benchmarks.soak_samples import SHARED_FIELDS
from benchmarks.soak_samples import Iterations
from benchmarks.soak_samples import Samples
from benchmarks.soak_slopes import Slope
from benchmarks.soak_slopes import fit
from benchmarks.soak_slopes import in_blocks
from ppo_agent_node.evaluation.metrics import write_json

_TICK = 0.2
"""s between two looks at the log of the training"""
_AFTERMATH = 15.0
"""s after a fault in which nodes start and find each other"""
_SPELL = 10.0
"""s of undisturbed training that make a point of steps/s"""
_SAVED = 60.0
"""s between two savings of what is known so far"""
_KINDS = {node: node.partition('_')[0].replace('sim', 'simulator') for node in NODES}
_FIGURES = {
    'own': 'memory of its own, MiB', 'rss': 'memory, RSS, MiB', 'files': 'open files',
    'threads': 'threads'}
_RATES = {
    'steps_per_second': 'steps/s', 'steps_per_cpu_second': 'steps per CPU-second'}


class Soak:
    """One soak: what it measured so far, and what that says."""

    def __init__(self, minutes: float, every: float, nodes: Nodes, table: Path) -> None:
        """Begin; the nodes run already.

        :param every: s between faults, on average
        """
        self.length, self._every = 60.0 * minutes, every
        self.nodes, self.samples = nodes, Samples(table)
        self.iterations = Iterations(nodes.run / 'train.jsonl', min(_SPELL, every / 4))
        self.elapsed = 0.0

    def rows(self) -> Iterator[tuple[str, str, Slope | None]]:
        """Yield what was measured, of what kind of node, and its slope."""
        warm_up, block = max(5.0, self.length / 30), max(5.0, self.length / 60)

        def slope(rows: list[dict[str, Any]], name: str, lives: list[str]) -> Slope | None:
            if not rows:
                return None
            numbers = np.unique(lives, return_inverse=True)[1].astype(np.float64)
            return fit(*in_blocks(
                np.array([row['time'] for row in rows]), np.array([row[name] for row in rows]),
                numbers, warm_up, block))

        for figure, title in _FIGURES.items():
            for kind in dict.fromkeys(_KINDS.values()):
                rows = [row for row in self.samples.rows if _KINDS[row['node']] == kind]
                lives = [f'{row["node"]} {row["life"]}' for row in rows]
                yield title, kind, slope(rows, figure, lives)
        for figure in SHARED_FIELDS:
            shared = self.samples.shared
            yield f'/dev/shm, {figure}', 'all', slope(shared, figure, ['1'] * len(shared))
        for figure, title in _RATES.items():
            rates = self.iterations.rows
            yield title, 'all', slope(rates, figure, ['1'] * len(rates))

    def figures(self) -> dict[str, Any]:
        """Return all that is known."""
        slopes = [
            {'what': what, 'of': kind, **(vars(slope) if slope else {}),
             'flat': slope.flat if slope else None}
            for what, kind, slope in self.rows()]
        return {
            'minutes': self.elapsed / 60, 'planned_minutes': self.length / 60,
            **self.nodes.told(), 'spells': len(self.iterations.rows), 'slopes': slopes}

    def run(self, period: float, save: Path | None) -> None:
        """Watch until the time is over.

        :param period: s between looks at the nodes
        """
        every = self._every
        began = time.monotonic()
        fault = began + self.nodes.until_next(every)
        look, saved, calm = began, began, began
        while (now := time.monotonic()) < began + self.length:
            self.elapsed = now - began
            self.nodes.tend()
            if now > fault:
                print(f'{self.elapsed / 60:6.1f} min: {self.nodes.disturb()}', flush=True)
                fault = now + self.nodes.until_next(every)
                calm = now + min(_AFTERMATH, every / 4)
            if now < calm:
                self.iterations.disturbed()
            self.iterations.look(self.elapsed, self.nodes.nodes)
            if now > look:
                look = now + period
                self.samples.take(self.elapsed, self.nodes.nodes, self.nodes.lives)
            if save and now > saved + _SAVED:
                saved = now
                write_json(save, self.figures())
            time.sleep(_TICK)
        self.elapsed = self.length


def table(figures: dict[str, Any]) -> Iterator[str]:
    """Yield the lines that say it all."""
    faults = ', '.join(f'{what} {count}' for what, count in sorted(figures['faults'].items()))
    yield f'{figures["minutes"]:.1f} of {figures["planned_minutes"]:g} minutes; {faults or "-"}'
    yield (f'{"":<28}{"of":<11}{"lives":>6}{"mean":>10}{"an hour":>10}{"":>9}'
           f'{"95 %":>22}')
    for row in figures['slopes']:
        head = f'{row["what"]:<28}{row["of"]:<11}'
        if row['flat'] is None:
            yield f'{head}  too short to say'
            continue
        part = 100 * row['per_hour'] / row['mean'] if row['mean'] else 0.0
        interval = f'[{row["low"]:.4g}, {row["high"]:.4g}]'
        verdict = 'flat' if row['flat'] else 'NOT FLAT'
        yield (f'{head}{row["lives"]:>6}{row["mean"]:>10.5g}{row["per_hour"]:>+10.3g}'
               f'{part:>+7.2f} %{interval:>22}  {verdict}')
    for line in figures['unexpected']:
        yield f'unexpected: {line}'
    if 'ended' in figures:
        ended = ', '.join(f'{name} {status}' for name, status in figures['ended'].items())
        yield f'told to end, they ended with: {ended}; files left in /dev/shm: {figures["left"]}'


def main() -> None:
    """Print the table, write the figures."""
    parser = argparse.ArgumentParser(prog='bench soak', description=__doc__.split('\n')[0])
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--every', type=float, default=60.0, help='s between faults, on average')
    parser.add_argument('--period', type=float, default=5.0, help='s between looks at the nodes')
    parser.add_argument('--num-envs', type=int, default=128, help='rockets in a simulator')
    parser.add_argument('--steps', type=int, default=128, help='of a roll-out, per rocket')
    parser.add_argument('--seed', type=int, default=1, help='of the faults')
    parser.add_argument('--output', type=Path, help='file for the figures, JSON')
    options = parser.parse_args()
    print(f'faults of seed {options.seed}', flush=True)
    # What ends this ends the nodes, too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        samples = options.output.with_name(
            f'{options.output.stem}_samples.csv') if options.output else folder / 'samples.csv'
        nodes, soak = Nodes(folder, options.seed, options.num_envs, options.steps), None
        ended: dict[str, int] = {}
        try:
            nodes.begin()
            soak = Soak(options.minutes, options.every, nodes, samples)
            soak.run(options.period, options.output)
        except KeyboardInterrupt:
            print('interrupted', flush=True)
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)
            ended = nodes.end()
        if soak is None:
            return
        figures = {**soak.figures(), 'ended': ended, 'left': soak.samples.clean()}
        soak.samples.close()
        if options.output:
            write_json(options.output, figures)
            soak_plot.draw(
                soak.samples, soak.iterations.rows, options.output.with_name(
                    f'{options.output.stem}_curves.png'))
        print('\n'.join(table(figures)), flush=True)


if __name__ == '__main__':
    main()
