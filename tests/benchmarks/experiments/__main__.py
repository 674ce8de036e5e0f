# SPDX-License-Identifier: Apache-2.0
"""Command line of the experiments: trains and flies policies, and writes tables and plots."""
from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any
from typing import NamedTuple

import torch

from benchmarks import machine
from benchmarks.experiments import claims
from benchmarks.experiments import ingredients
from benchmarks.experiments import reverse
from benchmarks.experiments import transfer
from benchmarks.experiments.flights import Sample
from benchmarks.experiments.options import Options
from benchmarks.experiments.plots import claims_plot
from benchmarks.experiments.plots import ingredients_plot
from benchmarks.experiments.plots import reverse_plot
from benchmarks.experiments.plots import transfer_plot
from benchmarks.reports import page
from ppo_agent_node.evaluation.conditions_files import aligned
from ppo_agent_node.evaluation.metrics import write_json

ROOT = Path(__file__).parents[3]
SEEDS = (11, 12, 13)
"""training seeds; published policies use 1 to 5, and settings are tuned with 101 and more"""
FLIGHT_SEED = 50_000_000
"""seed of the flights; no training, selection or published figure uses it"""


class Experiment(NamedTuple):
    """An experiment: its measurement, and the presentation of its figures."""

    measuring: Any
    """module with `measure` and `table`"""
    drawing: Any
    """module with `draw` and `title`"""
    episodes: int
    """default number for each task"""


EXPERIMENTS = {
    'claims': Experiment(claims, claims_plot, 1000),
    'ingredients': Experiment(ingredients, ingredients_plot, 1000),
    'reverse': Experiment(reverse, reverse_plot, 2000),
    'transfer': Experiment(transfer, transfer_plot, 300),
}


def arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(
        prog='bench experiments', formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Runs experiments on learning; docs/results/experiments.md has the results.',
        epilog='\n'.join(f'  {name:<12} {one.measuring.__doc__.splitlines()[0]}'
                         for name, one in EXPERIMENTS.items()))
    parser.add_argument('name', choices=list(EXPERIMENTS))
    parser.add_argument('--seeds', type=int, nargs='+', default=list(SEEDS), help='training seeds')
    parser.add_argument('--episodes', type=int, help='episodes per policy and task')
    parser.add_argument('--seed', type=int, default=FLIGHT_SEED, help='seed of the fresh starts')
    parser.add_argument('--runs', type=Path, help='folder of the runs; existing runs are used')
    parser.add_argument('--quick', action='store_true', help='only check that the program works')
    parser.add_argument(
        '--page', action='store_true', help='put the results into docs/results/experiments.md')
    parser.add_argument(
        '--output', type=Path, help='JSON file for the figures; the plot is saved beside it')
    given = parser.parse_args()
    if given.page and not given.output:
        parser.error('--page: got no --output, expected the file that keeps the figures')
    return given


def measure(name: str, options: Options) -> dict[str, Any]:
    """Return the figures of an experiment, with command, machine, commit and seeds."""
    experiment, began = EXPERIMENTS[name], time.process_time()
    figures = experiment.measuring.measure(options)
    figures |= {
        'experiment': name,
        'command': repeating(name, options),
        'machine': machine.describe(), 'quick': options.quick,
        'training_seeds': list(options.seeds), 'flight_seed': options.sample.seed,
        'episodes': options.sample.episodes,
        'cpu_seconds': {
            'training': round(sum(run['cpu_seconds'] for run in figures['runs']), 1),
            'this command': round(time.process_time() - began, 1)}}
    return {**figures, 'finding': experiment.drawing.title(figures)}


def repeating(name: str, options: Options) -> str:
    """Return the command that repeats the experiment, with options that are not default."""
    words = ['./launch_scripts/bench', 'experiments', name]
    if tuple(options.seeds) != SEEDS:
        words += ['--seeds', *map(str, options.seeds)]
    if options.sample.episodes != EXPERIMENTS[name].episodes:
        words += ['--episodes', str(options.sample.episodes)]
    if options.sample.seed != FLIGHT_SEED:
        words += ['--seed', str(options.sample.seed)]
    return ' '.join(words + ['--quick'] * options.quick)


def main() -> None:
    """Run an experiment and print its results."""
    given = arguments()
    torch.set_num_threads(1)
    experiment = EXPERIMENTS[given.name]
    runs = given.runs or ROOT / 'runs' / ('experiments-quick' if given.quick else 'experiments')
    episodes = given.episodes or (16 if given.quick else experiment.episodes)
    figures = measure(given.name, Options(
        given.seeds, Sample(episodes, given.seed), runs, given.quick))
    table = aligned(experiment.measuring.table(figures))
    print(figures['finding'], page.facts(figures), table, sep='\n\n')
    if given.output:
        write_json(given.output, figures)
        picture = experiment.drawing.draw(
            json.loads(given.output.read_text('utf-8')),
            given.output.with_name(f'experiments_{given.name}.png'))
        if given.page:
            page.write(
                ROOT / 'docs' / 'results' / 'experiments.md', picture, given.name, figures, table)


if __name__ == '__main__':
    main()
