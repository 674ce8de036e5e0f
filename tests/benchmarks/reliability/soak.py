# SPDX-License-Identifier: Apache-2.0
"""A long training with kills, to check that memory, open files and steps/s stay flat.

Two simulators, an agent that trains in both, and a recorder for each simulator run as separate
processes. About once a minute one of them is killed with `kill -9` and replaced, or stopped for
3 s. Every few seconds all of them are sampled. At the end each figure has its slope per hour with
a 95 % interval (see soak_slopes). It is flat if the interval contains zero, or if the slope is
below 1 % of the mean.

Each node has its own row, from its processes that live for a fifth of the soak or more: `sim_0`
and `recorder_0` run all the time, an agent for two thirds. A process that is killed every few
minutes is never old enough to leak much. Such processes are compared with each other at the age of
a minute, which would show leaks that are passed on from one to the next.

Steps/s are measured in periods of 10 s of training during which, and shortly before which, nothing
happened. Steps per second of processor time, of agent and simulators, are less sensitive to other
load on the machine. Steps in the time that a fixed piece of work takes
(`soak_samples.piece_of_work`) are less sensitive to a machine whose speed changes.
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

from benchmarks.reliability import soak_plot
from benchmarks.reliability.soak_nodes import NODES
from benchmarks.reliability.soak_nodes import YOUNG
from benchmarks.reliability.soak_nodes import Nodes
from benchmarks.reliability.soak_samples import Iterations
from benchmarks.reliability.soak_samples import Row
from benchmarks.reliability.soak_samples import Samples
from benchmarks.reliability.soak_samples import read
from benchmarks.reliability.soak_slopes import Slope
from benchmarks.reliability.soak_slopes import Values
from benchmarks.reliability.soak_slopes import at_age
from benchmarks.reliability.soak_slopes import fit
from benchmarks.reliability.soak_slopes import in_blocks
from ppo_agent_node.evaluation.metrics import write_json

_TICK = 0.2
"""s between two reads of the training log"""
_AFTERMATH = 15.0
"""s after a fault, in which nodes start and discover each other; steps/s are not measured"""
_SPELL = 10.0
"""s of undisturbed training for each value of steps/s"""
_LIFE = 1 / 5
"""part of the soak; processes that live less are left out"""
_AGE = 60.0
"""s; age at which short-lived processes are compared with each other"""
_SAVED = 60.0
"""s between two writes of the figures so far"""
_FIGURES = {
    'own': 'memory of its own, MiB', 'rss': 'memory, RSS, MiB', 'files': 'open files',
    'threads': 'threads'}
_RATES = {
    'steps_per_second': 'steps/s', 'steps_per_cpu_second': 'steps per CPU-second',
    'steps_per_piece': 'steps per piece of work'}
_MACHINE = _RATES['steps_per_second'], _RATES['steps_per_cpu_second']
"""figures that also depend on the machine, whose speed varies"""


def slopes(looks: list[Row], rates: list[Row], length: float) -> list[dict[str, Any]]:
    """Return the slope of each figure, for each node.

    :param looks: samples of the nodes, in order; `rates`: speeds of the training.
    :param length: elapsed time of the soak, s.
    """
    warm_up, block = max(5.0, length / 30), max(5.0, length / 60)

    def entry(what: str, of: str, found: Slope | None) -> dict[str, Any]:
        return {'what': what, 'of': of, **(vars(found) if found else {}),
                'flat': found.flat if found else None}

    def columns(rows: list[Row], name: str) -> tuple[Values, Values, Values]:
        return (np.array([row['time'] for row in rows], np.float64),
                np.array([row[name] for row in rows], np.float64),
                np.array([row.get('life', 1) for row in rows], np.float64))

    def one(
        what: str, of: str, rows: list[Row], name: str, shortest: float = 0.0,
    ) -> dict[str, Any]:
        return entry(what, of, fit(*in_blocks(*columns(rows, name), warm_up, block, shortest)))

    def young(node: str) -> dict[str, Any]:
        # The first process of a node starts differently: recorders are stopped for a while.
        rows = [row for row in looks if row['node'] == node and row['life'] > 1]
        hours, values, ones = at_age(*columns(rows, 'own'), _AGE)
        found = entry(f'memory at {_AGE:g} s, MiB', node, fit(hours, values, ones))
        return {**found, 'lives': len(values)}

    return [
        *(one(title, node, [row for row in looks if row['node'] == node], figure,
              _LIFE * length)
          for figure, title in _FIGURES.items() for node in NODES),
        *(young(node) for node in YOUNG),
        *(one(title, 'all', rates, figure) for figure, title in _RATES.items())]


class Soak:
    """A soak: runs it, and collects and evaluates its measurements."""

    def __init__(self, minutes: float, every: float, nodes: Nodes, table: Path) -> None:
        """Start; the nodes must run already.

        :param every: mean time between faults, s
        """
        self.length, self._every = 60.0 * minutes, every
        self.nodes, self.samples = nodes, Samples(table)
        self.iterations = Iterations(nodes.run / 'train.jsonl', min(_SPELL, every / 4))
        self.elapsed = 0.0

    def figures(self) -> dict[str, Any]:
        """Return all figures so far."""
        return {
            'minutes': self.elapsed / 60, 'planned_minutes': self.length / 60,
            **self.nodes.incidents(), 'spells': len(self.iterations.rows),
            'slopes': slopes(self.samples.rows, self.iterations.rows, self.elapsed)}

    def run(self, period: float, save: Path | None) -> None:
        """Cause faults and take samples until the end of the soak.

        :param period: s between samples of the nodes
        """
        every = self._every
        began = time.monotonic()
        fault = began + self.nodes.until_next(every)
        look, saved, calm = began, began, began
        while (now := time.monotonic()) < began + self.length:
            self.elapsed = now - began
            self.nodes.tend()
            if now > fault:
                done = self.nodes.disturb(self.elapsed / self.length)
                print(f'{self.elapsed / 60:6.1f} min: {done}', flush=True)
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
    """Yield the lines of the report."""
    faults = ', '.join(f'{what} {count}' for what, count in sorted(figures['faults'].items()))
    yield f'{figures["minutes"]:.1f} of {figures["planned_minutes"]:g} minutes; {faults or "-"}'
    yield from slope_lines(figures['slopes'])
    for line in figures['unexpected']:
        yield f'unexpected: {line}'
    if 'ended' in figures:
        ended = ', '.join(f'{name} {status}' for name, status in figures['ended'].items())
        yield f'told to end, they ended with: {ended}'


def slope_lines(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a line for each slope."""
    yield (f'{"":<28}{"of":<11}{"lives":>6}{"mean":>10}{"an hour":>10}{"":>9}'
           f'{"95 %":>22}')
    for row in rows:
        head = f'{row["what"]:<28}{row["of"]:<11}'
        if row['flat'] is None:
            yield f'{head}  too short to say'
            continue
        part = 100 * row['per_hour'] / row['mean'] if row['mean'] else 0.0
        interval = f'[{row["low"]:.4g}, {row["high"]:.4g}]'
        verdict = 'flat' if row['flat'] else 'NOT FLAT'
        yield (f'{head}{row["lives"]:>6}{row["mean"]:>10.5g}{row["per_hour"]:>+10.3g}'
               f'{part:>+7.2f} %{interval:>22}  {verdict}')


def failures(figures: dict[str, Any]) -> list[str]:
    """Return the failures: unexpected exits, figures that grow, and work that gets slower."""
    found = list(figures['unexpected'])
    for row in figures['slopes']:
        if row['flat'] is not False or row['what'] in _MACHINE:
            continue
        if (row['per_hour'] > 0) != (row['what'] == _RATES['steps_per_piece']):
            found.append(f'{row["what"]} of {row["of"]}: {row["per_hour"]:+.3g} an hour')
    return found


def main() -> None:
    """Print the table and write the figures; exit with 1 if a complete soak is not flat."""
    parser = argparse.ArgumentParser(prog='bench soak', description=__doc__.split('\n')[0])
    parser.add_argument('--minutes', type=float, default=60.0, help='duration in minutes')
    parser.add_argument('--every', type=float, default=60.0, help='average time between faults, s')
    parser.add_argument('--period', type=float, default=5.0, help='time between samples, s')
    parser.add_argument('--num-envs', type=int, default=128, help='rockets per simulator')
    parser.add_argument('--steps', type=int, default=128, help='steps per rocket in a roll-out')
    parser.add_argument('--seed', type=int, default=1, help='seed of the faults')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    parser.add_argument('--again', type=Path, help='only fit the samples of an earlier soak, CSV')
    parser.add_argument('--between', type=float, nargs=2, default=(0.0, float('inf')),
                        metavar='MINUTE',
                        help='with --again: use only samples between these minutes')
    options = parser.parse_args()
    if options.again:
        first, last = (60.0 * minute for minute in options.between)
        looks = [row for row in read(options.again) if first <= row['time'] <= last]
        if not looks:
            parser.error(f'--between: no samples of {options.again} between these minutes')
        print('\n'.join(slope_lines(slopes(looks, [], looks[-1]['time'] - looks[0]['time']))))
        return
    print(f'faults of seed {options.seed}', flush=True)
    # SIGTERM must also end the nodes.
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
        figures = {**soak.figures(), 'ended': ended}
        soak.samples.close()
        if options.output:
            write_json(options.output, figures)
            soak_plot.draw(
                soak.samples, soak.iterations.rows, options.output.with_name(
                    f'{options.output.stem}_curves.png'))
        print('\n'.join(table(figures)), flush=True)
    if soak.elapsed >= soak.length and (found := failures(figures)):
        parser.exit(1, ''.join(f'not flat: {line}\n' for line in found))


if __name__ == '__main__':
    main()
