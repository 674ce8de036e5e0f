# SPDX-License-Identifier: Apache-2.0
"""Samples/s of a PPO update, ours and that of Stable-Baselines3, by network, batch and threads.

All learn from one fixed batch, with equal networks, weights, minibatches, epochs and settings, in
float32, without early stopping. Stable-Baselines3 is measured with idle threads that spin (torch's
default) and with idle threads that sleep, as ours do; the faster case counts. All cases are
measured alternately; medians are reported. The lower bound is the time of the bare matrix
products, with the fastest of MKL on whole minibatches, MKL on pieces of 512 rows, and oneDNN on
pieces of 1024 rows. `autograd` is our update with the same networks, but with torch's
differentiation and fused Adam instead of hand-written gradients.
"""
from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import statistics
from pathlib import Path
from typing import Any

from benchmarks.networks.learner_sides import CASES
from benchmarks.networks.learner_sides import SIDES
from benchmarks.networks.learner_sides import Options
from benchmarks.networks.learner_sides import Served


def measure(options: Options, rounds: int) -> dict[str, Any]:
    """Return samples/s of each side, their ratios and the losses of the updates."""
    served = {
        name: Served(name, options) for name in SIDES
        if not name.startswith('SB3') or (
            importlib.util.find_spec('stable_baselines3')
            and (name == 'SB3' or options.threads > 1))}
    rates: dict[str, list[float]] = {name: [] for name in served}
    losses: dict[str, dict[str, float]] = {}
    try:
        for number in range(rounds + 1):
            for name, side in served.items():
                seconds, losses[name] = side.update()
                if number:  # the first update is a warm-up
                    rates[name].append(side.samples / seconds)
    finally:
        for side in served.values():
            side.close()
    found = {name: statistics.median(values) for name, values in rates.items()}
    floor = max(rate for name, rate in found.items() if name.startswith('floor'))
    theirs = max((name for name in found if name.startswith('SB3')), key=found.get, default=None)
    figures: dict[str, Any] = {
        **dataclasses.asdict(options), 'samples_per_second': found, 'told': losses,
        'floor': floor, 'part_of_floor': {
            'ours': found['ours'] / floor, **({'SB3': found[theirs] / floor} if theirs else {})},
        'floor_gflops': 1e-9 * losses['floor']['flops'] * floor / served['floor'].samples}
    figures['autograd_ratio'] = statistics.median(
        a / b for a, b in zip(rates['ours'], rates['autograd'], strict=True))
    if theirs:
        figures['SB3'] = found[theirs]
        figures['ratio'] = statistics.median(
            a / b for a, b in zip(rates['ours'], rates[theirs], strict=True))
    return figures


def line(figures: dict[str, Any]) -> str:
    """Return one row of the table."""
    rates, part = figures['samples_per_second'], figures['part_of_floor']
    theirs = (f'{figures["SB3"]:>10,.0f}{figures["ratio"]:>7.2f}' if 'SB3' in figures
              else f'{"":>17}')
    return (f'{figures["threads"]:>8}{rates["ours"]:>10,.0f}{rates["autograd"]:>10,.0f}'
            f'{figures["autograd_ratio"]:>7.2f}{theirs}{figures["floor"]:>10,.0f}'
            f'{figures["floor_gflops"]:>9.0f}{part["ours"]:>7.0%}'
            + (f'{part["SB3"]:>6.0%}' if 'SB3' in part else ''))


def main() -> None:
    """Print the tables and write the figures."""
    parser = argparse.ArgumentParser(prog='bench learner', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=7, help='number of rounds')
    parser.add_argument(
        '--threads', type=int, nargs='+', default=[1, 2], help='numbers of threads')
    parser.add_argument(
        '--device', default='cpu', choices=('auto', 'cpu', 'cuda'), help='device of the updates')
    parser.add_argument('--cases', type=int, nargs='+', default=list(range(len(CASES))),
                        help='; '.join(f'{k}: {case.name}' for k, case in enumerate(CASES)))
    parser.add_argument('--samples', type=int, default=0,
                        help='samples in the batch; 0: as many as the preset flies')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if importlib.util.find_spec('stable_baselines3') is None:
        print('Stable-Baselines3 is not installed; ./launch_scripts/bench learner installs it')
    results = []
    print(f'samples x epochs per second, median of {options.rounds} rounds, float32, '
          f'device {options.device}')
    for case in (CASES[k] for k in options.cases):
        print(case.name)
        print(f'{"threads":>8}{"ours":>10}{"autograd":>10}{"ratio":>7}{"SB3":>10}{"ratio":>7}'
              f'{"floor":>10}{"GFLOP/s":>9}'
              f'{"ours":>7}{"SB3":>6} of floor')
        for threads in options.threads:
            results.append(measure(
                Options(case, threads, options.device, options.samples), options.rounds))
            print(line(results[-1]), flush=True)
    if options.output:
        # Imported late: it changes the settings of torch's threads, which the other side must not
        # inherit.
        from ppo_agent_node.evaluation.metrics import write_json

        write_json(options.output, {'learner': results})


if __name__ == '__main__':
    main()
