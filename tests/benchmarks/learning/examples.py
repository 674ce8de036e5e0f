# SPDX-License-Identifier: Apache-2.0
"""Trains the examples of docs/examples with several seeds and draws their learning curves.

Runs are separate processes, one after the other. A run ends when the last 100 episodes return
the target on average, or when its budget of steps is used up. An existing run is used as it is, so
a sweep can be stopped and continued.
"""
from __future__ import annotations

import argparse
import importlib.util
import json
import math
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import machine
from benchmarks.learning import examples_plot
from benchmarks.reports import page
from ppo_agent_node.evaluation.conditions_files import aligned
from ppo_agent_node.evaluation.metrics import write_json

ROOT = Path(__file__).parents[3]
PAGE = ROOT / 'docs' / 'results' / 'libraries.md'
NAMES = {
    'single_file_ppo': 'PPO in a single file', 'sb3_ppo': "stable-baselines3's PPO",
    'rsl_rl_ppo': "rsl_rl's PPO", 'torchrl_ppo': "TorchRL's PPO",
    'sb3_sac': "stable-baselines3's SAC"}
NEEDS = {
    'sb3_ppo': 'stable_baselines3', 'rsl_rl_ppo': 'rsl_rl', 'torchrl_ppo': 'torchrl',
    'sb3_sac': 'stable_baselines3'}
STEPS = {
    'lunar_lander': {'sb3_sac': 300_000, 'default': 1_000_000},
    'rocket': {'sb3_sac': 100_000, 'default': 3_000_000}}
"""budgets"""
TARGETS = {'lunar_lander': 200.0, 'rocket': 1000.0}
"""mean returns at which a run ends; that of rockets is out of reach, so they use all steps"""
SEEDS = {'lunar_lander': (1, 2, 3, 4, 5), 'rocket': (1, 2, 3)}


def budget(world: str, example: str) -> int:
    """Return the number of steps of a run."""
    steps = STEPS[world]
    return steps.get(example, steps['default'])


def place(options: argparse.Namespace, example: str, world: str, seed: int) -> Path:
    """Return the file of a run."""
    runs: Path = options.runs
    return runs / f'{example}-{world}-{seed}.json'


def train(options: argparse.Namespace, example: str, world: str, seed: int) -> dict[str, Any]:
    """Train an example, or return the existing run.

    :raises CalledProcessError: if the training failed.
    :raises SystemExit: if no episode ended.
    """
    steps = options.steps or budget(world, example)
    path = place(options, example, world, seed)
    if path.exists():
        found: dict[str, Any] = json.loads(path.read_text('utf-8'))
        if found['budget'] != steps:
            raise ValueError(
                f'{path}: trained with {found["budget"]} steps instead of {steps}; move it away, '
                'or name another folder with --runs')
        return found
    done = subprocess.run(
        [sys.executable, '-m', 'benchmarks.learning.examples_run', example, world, str(seed),
         str(steps), str(TARGETS[world])], check=True, stdout=subprocess.PIPE, text=True,
        env=machine.child_environment())
    last = done.stdout.splitlines()[-1]  # TorchRL logs to the same stream
    found = {**json.loads(last), 'budget': steps, 'machine': machine.describe()}
    if math.isnan(found['curve'][-1]['mean_return']):
        sys.exit(f'bench examples: steps: got {steps}, expected enough for an episode to end')
    options.runs.mkdir(parents=True, exist_ok=True)
    write_json(path, found)
    return found


def tell(run: dict[str, Any]) -> None:
    """Print a line about a run."""
    last = run['curve'][-1]
    reach = '' if run['reach'] is None else (
        ', full task' if run['reach'] == 0 else f', starts up to {run["reach"]:.1f} m')
    print(f'{NAMES[run["example"]]:<26}{run["world"]:<14}{run["seed"]:>3}'
          f'{run["steps"]:>11,} steps{run["cpu_seconds"]:>8.0f} s, '
          f'return {last["mean_return"]:.1f}, landed {100 * last["landed"]:.0f} %{reach}',
          flush=True)


def spread(values: Sequence[float], form: str) -> str:
    """Return median and range, or the only value."""
    median = f'{statistics.median(values):{form}}'
    if len(values) == 1:
        return median
    return f'{median} ({min(values):{form}} to {max(values):{form}})'


def table(world: str, runs: Sequence[dict[str, Any]]) -> str:
    """Return a row of Markdown for each example."""
    rockets = world != 'lunar_lander'
    rows: list[Sequence[str]] = [(
        'example', 'seeds', *(('budget, steps', 'starts up to, m', 'landed, %') if rockets else (
            f'reached {TARGETS[world]:g}', 'steps')), 'processor time, s')]
    for example in dict.fromkeys(run['example'] for run in runs):
        own = [run for run in runs if run['example'] == example]
        seconds = spread([run['cpu_seconds'] for run in own], '.0f')
        if rockets:
            reached = [run['reach'] or examples_plot.FULL_REACH for run in own]
            columns = [f'{own[0]["budget"]:,}', spread(reached, '.1f'), spread(
                [100 * run['curve'][-1]['landed'] for run in own], '.0f')]
        else:
            columns = [f'{sum(run["passed"] for run in own)} of {len(own)}',
                       spread([run['steps'] for run in own], ',.0f')]
        rows.append((NAMES[example], ', '.join(str(run['seed']) for run in own), *columns,
                     seconds))
    return aligned(rows)


def facts(runs: Sequence[dict[str, Any]], command: str) -> str:
    """Return one line with command, date, commit and machine of the figures."""
    dates, commits, processors = (
        ', '.join(sorted({run['machine'][name] for run in runs}))
        for name in ('date', 'commit', 'processor'))
    return f'`{command}`: {dates}, commit {commits}; {len(runs)} runs, {processors}.'


def repeating(options: argparse.Namespace, world: str) -> str:
    """Return the command that repeats the runs, with all options that differ from default."""
    words = ['./launch_scripts/bench examples --worlds', world]
    if list(options.examples) != list(NAMES):
        words += ['--examples', *options.examples]
    if options.seeds:
        words += ['--seeds', *map(str, options.seeds)]
    if options.steps:
        words += ['--steps', str(options.steps)]
    return ' '.join(words)


def main() -> None:
    """Train, print the table, and write figures and plots."""
    parser = argparse.ArgumentParser(prog='bench examples', description=__doc__)
    parser.add_argument(
        '--worlds', nargs='+', choices=list(STEPS), default=list(STEPS), help='worlds')
    parser.add_argument(
        '--examples', nargs='+', choices=list(NAMES), default=list(NAMES), help='examples')
    parser.add_argument(
        '--seeds', type=int, nargs='+', help='training seeds; by default 1 to 5 for the lander and'
        ' 1 to 3 for the rocket')
    parser.add_argument('--steps', type=int, help='budget of each run, environment steps')
    parser.add_argument(
        '--runs', type=Path, default=ROOT / 'runs' / 'examples', help='folder of the runs')
    parser.add_argument(
        '--existing', action='store_true', help='only show the runs that exist, without training')
    parser.add_argument(
        '--page', action='store_true', help='put the results into docs/results/libraries.md')
    parser.add_argument('--output', type=Path, help='JSON file for the figures; pictures beside')
    options = parser.parse_args()
    missing = [name for name in options.examples
               if importlib.util.find_spec(NEEDS.get(name, 'torch')) is None]
    for name in missing:
        print(f'{NAMES[name]}: left out, package {NEEDS[name]} is not installed')
    examples = [name for name in options.examples if name not in missing]
    if not examples:
        parser.error('none of the examples can run')
    figures: dict[str, Any] = {}
    for world in options.worlds:
        runs = []
        for seed in options.seeds or SEEDS[world]:
            for example in examples:
                if options.existing and not place(options, example, world, seed).exists():
                    continue
                runs.append(train(options, example, world, seed))
                tell(runs[-1])
        runs.sort(key=lambda run: list(NAMES).index(run['example']))
        text = table(world, runs)
        print(f'\n{text}\n')
        command = repeating(options, world)
        figures[world] = {'runs': runs, 'command': command}
        if options.output:
            picture = options.output.with_name(f'{options.output.stem}_{world}.png')
            examples_plot.draw(world, runs, NAMES, TARGETS[world], picture)
            if options.page:
                image = page.keep_picture(PAGE, picture, f'examples_{world}.png')
                page.put(PAGE, world, '\n\n'.join((
                    facts(runs, command), text,
                    f'![{examples_plot.title(world, runs, NAMES)}](../images/{image})')))
    if options.output:
        write_json(options.output, figures)


if __name__ == '__main__':
    main()
