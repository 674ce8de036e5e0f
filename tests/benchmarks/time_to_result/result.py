# SPDX-License-Identifier: Apache-2.0
"""Time to a result, from the start of the processes to an evaluation that passes.

`lunar_lander`: ours, simulator and agent as nodes over DDS, by imitation of Gymnasium's heuristic
pilot (preset `quick`) and by PPO alone (preset `from_scratch`); a tuned PPO in one process on
EnvPool; and stable-baselines3 with the settings of its zoo. 100 deterministic episodes or more in
the program's own lander must return 200 on average. Afterwards each policy that has passed
flies in Gymnasium's lander, untimed. `rocket`: only ours, preset `quick`, until 99 % of 2 000
fresh starts on level 7 land. All runs use the same cores, one run at a time, seed by seed. The
time includes imports, discovery and evaluations, but not reading libraries from the disk.
"""
from __future__ import annotations

import argparse
import os
import statistics
from collections.abc import Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

from benchmarks.time_to_result import result_plot
from benchmarks.time_to_result.result_records import Options
from benchmarks.time_to_result.result_records import TimedRun
from benchmarks.time_to_result.result_runs import CONTESTANTS
from benchmarks.time_to_result.result_runs import NEEDED_RATE
from benchmarks.time_to_result.result_runs import OURS
from benchmarks.time_to_result.result_runs import rocket
from ppo_agent_node.config.presets import preset_num_envs
from ppo_agent_node.evaluation.metrics import write_json

NAMES = {
    'ours': 'ours, imitation', 'ours_from_scratch': 'ours, PPO alone',
    'envpool_ppo': 'PPO on EnvPool', 'sb3_lander': 'stable-baselines3', 'rocket': 'rocket, ours'}
WORLDS = ('lunar_lander', 'rocket')
TUNED_ON = range(1, 11), range(31, 36), range(101, 107), range(111, 119)
"""Seeds on which the settings of our presets and of the PPO on EnvPool were chosen: no seeds for a
figure to be published."""
REFUSED = ', '.join(f'{seeds.start} to {seeds.stop - 1}' for seeds in TUNED_ON)


def fly(options: argparse.Namespace) -> list[TimedRun]:
    """Run all contestants for each seed, and print a line about each run."""
    common = Options(options.target, options.cap, options.verify, parameters(options.set))
    runs = []
    for seed in sorted({*options.seeds, *options.sb3_seeds}):
        for name in options.contestants:
            if seed in (options.sb3_seeds if name == 'sb3_lander' else options.seeds):
                runs.append(CONTESTANTS[name](seed, common))
                tell(runs[-1])
    return runs


def parameters(given: Sequence[str]) -> dict[str, str]:
    """Return NAME=VALUE arguments as a dictionary."""
    return dict(item.split('=', 1) for item in given)


def tell(run: TimedRun) -> None:
    """Print the results of a run."""
    line = (f'{NAMES[run.contestant]:<20}{run.seed:>5}{seconds(run):>10}'
            f'{run.learning_seconds or 0:>10.1f}{run.steps:>11,}{run.mean_return:>9.1f}')
    if run.gymnasium:
        line += f'{run.gymnasium["mean_return"]:>11.1f} ± {run.gymnasium["deviation"]:.1f}'
    print(line, flush=True)


def seconds(run: TimedRun) -> str:
    """Return the duration of a run as text; `> s` if it reached the time limit."""
    return f'{run.seconds:.1f}' if run.passed else f'> {run.seconds:.0f}'


def summarise(runs: Sequence[TimedRun]) -> dict[str, dict[str, float]]:
    """Return median and range of the times of each contestant; the limit counts as a time."""
    found = {}
    for name in dict.fromkeys(run.contestant for run in runs):
        own = [run for run in runs if run.contestant == name]
        found[name] = {
            'seeds': len(own), 'passed': sum(run.passed for run in own),
            **spread('seconds', [run.seconds for run in own]),
            **spread('learning_seconds', [
                run.learning_seconds for run in own if run.learning_seconds is not None]),
            **spread('steps', [float(run.steps) for run in own]),
            **spread('gymnasium_return', [
                run.gymnasium['mean_return'] for run in own if run.gymnasium]),
        }
    return found


def spread(name: str, values: Sequence[float]) -> dict[str, float]:
    """Return median, minimum and maximum of some values, under names that begin with `name`."""
    if not values:
        return {}
    return {name: statistics.median(values), f'{name}_least': min(values),
            f'{name}_most': max(values)}


def ratios(summary: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Return the ratios of the median times of each of ours and each peer."""
    return {ours: {
        name: summary[ours]['seconds'] / row['seconds']
        for name, row in summary.items() if name not in OURS} for ours in OURS if ours in summary}


def settings(contestants: Sequence[str]) -> dict[str, Any]:
    """Return the settings of each contestant that are the same in all runs."""
    found: dict[str, Any] = {name: {
        'preset': preset, 'num_envs': preset_num_envs(preset, 'lunar_lander'), 'simulators': 1,
    } for name, preset in OURS.items() if name in contestants}
    if 'envpool_ppo' in contestants:
        from benchmarks.time_to_result import envpool_ppo

        found['envpool_ppo'] = {
            **asdict(envpool_ppo.Settings()), 'torch_threads': envpool_ppo.THREADS,
            'envpool_threads': envpool_ppo.ENV_THREADS}
    if 'sb3_lander' in contestants:
        from benchmarks.time_to_result import sb3_lander

        found['sb3_lander'] = {
            **sb3_lander.SETTINGS, 'n_envs': sb3_lander.ENVIRONMENTS,
            'torch_threads': sb3_lander.THREADS,
            'evaluated_every': sb3_lander.INTERVAL}
    return found


def lander(options: argparse.Namespace) -> dict[str, Any]:
    """Compare the contestants on the lander; print the table and return the figures."""
    print('lunar_lander: seconds until 100 deterministic episodes or more return '
          f'{options.target:g}')
    print(f'{"":<20}{"seed":>5}{"s":>10}{"learning":>10}{"steps":>11}{"mean":>9}'
          f'{"Gymnasium":>16}')
    runs = fly(options)
    summary = summarise(runs)
    print(f'{"median [range]":<20}{"passed":>8}{"s":>22}{"learning":>22}{"steps":>29}')
    for name, row in summary.items():
        print(f'{NAMES[name]:<20}{row["passed"]:>4} of {row["seeds"]}'
              + middle(row, 'seconds', '.1f', 22) + middle(row, 'learning_seconds', '.1f', 22)
              + middle(row, 'steps', ',.0f', 29))
    compared = ratios(summary)
    for ours, peers in compared.items():
        for peer, ratio in peers.items():
            late = [NAMES[name] for name in (ours, peer)
                    if summary[name]['passed'] < summary[name]['seeds']]
            print(f'{NAMES[ours]}: {ratio:.2f} times as long as {NAMES[peer]}'
                  + (f'; not all runs passed of: {", ".join(late)}' if late else ''))
    if options.output:
        result_plot.draw(
            runs, NAMES, options.target, options.output.with_name(
                f'{options.output.stem}_lunar_lander.png'), headline(summary))
    return {
        'target': options.target, 'cap': options.cap, 'settings': settings(options.contestants),
        'runs': [asdict(run) for run in runs], 'summary': summary, 'ratios': compared}


def headline(summary: dict[str, dict[str, float]]) -> str:
    """Return the median times of the contestants all of whose runs passed."""
    found = [f'{NAMES[name]} {row["seconds"]:.0f} s'
             for name, row in summary.items() if row['passed'] == row['seeds']]
    return f'Medians: {"; ".join(found) or "not all runs passed"}'


def middle(row: dict[str, float], name: str, form: str, width: int) -> str:
    """Return median and range as a column."""
    if name not in row:
        return ' ' * width
    text = f'{row[name]:{form}} [{row[f"{name}_least"]:{form}}, {row[f"{name}_most"]:{form}}]'
    return f'{text:>{width}}'


def fly_rocket(options: argparse.Namespace) -> dict[str, Any]:
    """Train rockets from scratch; print the table and return the figures."""
    print('rocket, level 7: seconds from nothing to the end of the evaluation of 2 000 starts')
    print(f'{"seed":>5}{"s":>8}{"landed":>10}{"return":>9}{"clone after":>13}{"landed":>9}'
          f'{"return":>9}')
    runs = []
    for seed in options.rocket_seeds:
        run = rocket(seed, options.cap, parameters(options.set_rocket))
        runs.append(run)
        line = f'{seed:>5}{seconds(run):>8}'
        if run.evaluations:
            clone, last = run.evaluations[0], run.evaluations[-1]
            line += (f'{100 * (last.landing_rate or 0):>8.2f} %{last.mean_return:>9.2f}'
                     f'{clone.seconds:>11.1f} s{100 * (clone.landing_rate or 0):>7.1f} %'
                     f'{clone.mean_return:>9.2f}')
        print(line, flush=True)
    summaries = summarise(runs)
    summary = summaries['rocket']
    print(f'{summary["passed"]} of {summary["seeds"]} land {100 * NEEDED_RATE:g} %, median '
          f'{middle(summary, "seconds", ".1f", 0)} s')
    if options.output:
        result_plot.draw(runs, NAMES, 0.0, options.output.with_name(
            f'{options.output.stem}_rocket.png'), headline(summaries))
    return {'runs': [asdict(run) for run in runs], 'summary': summary}


def main() -> None:
    """Print the tables, and write the figures and the plots."""
    parser = argparse.ArgumentParser(
        prog='bench result', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        '--worlds', nargs='+', choices=WORLDS, default=list(WORLDS), help='worlds to train in')
    parser.add_argument(
        '--contestants', nargs='+', choices=list(CONTESTANTS), default=list(CONTESTANTS),
        help='programs to train')
    parser.add_argument(
        '--seeds', type=int, nargs='*', default=[11, 12, 13, 14, 15],
        help=f'training seeds; {REFUSED} are refused: settings were chosen on them')
    parser.add_argument(
        '--sb3-seeds', type=int, nargs='*', default=[11, 12],
        help='training seeds of stable-baselines3')
    parser.add_argument(
        '--rocket-seeds', type=int, nargs='+', default=[11, 12, 13],
        help='training seeds for the rocket')
    parser.add_argument(
        '--target', type=float, default=200.0, help='mean return that has to be reached')
    parser.add_argument('--cap', type=float, default=1800.0, help='time limit of a run, s')
    parser.add_argument(
        '--verify', type=int, default=500, help="untimed episodes in Gymnasium's lander")
    parser.add_argument(
        '--cores', type=int, default=2, help='number of cores for all processes of a run')
    parser.add_argument(
        '--set', nargs='+', default=[], metavar='NAME=VALUE',
        help="parameters of our lander's agent")
    parser.add_argument(
        '--set-rocket', nargs='+', default=[], metavar='NAME=VALUE',
        help="parameters of the rocket's agent")
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    tuned = sorted({*options.seeds, *options.sb3_seeds, *options.rocket_seeds} & {
        *chain(*TUNED_ON)})
    if tuned:
        parser.error(
            f'seeds: got {", ".join(map(str, tuned))}, expected none of {REFUSED}: '
            'the settings were chosen on them')
    cores = sorted(os.sched_getaffinity(0))[:options.cores]
    os.sched_setaffinity(0, cores)
    print(f'all runs on cores {", ".join(map(str, cores))}')
    figures: dict[str, Any] = {'cores': len(cores)}
    if 'lunar_lander' in options.worlds:
        figures['lunar_lander'] = lander(options)
        if options.output:
            write_json(options.output, figures)  # minutes of work, whatever comes after
    if 'rocket' in options.worlds:
        figures['rocket'] = fly_rocket(options)
    if options.output:
        write_json(options.output, figures)


if __name__ == '__main__':
    main()
