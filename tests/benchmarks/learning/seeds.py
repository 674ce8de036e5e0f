# SPDX-License-Identifier: Apache-2.0
"""Trains a preset with several seeds and flies each policy from fresh starts without noise.

Trainings run one after the other through `launch_scripts/train`, with simulator and agent as nodes
over DDS, or all in this process with --in-process, which is slower on an idle machine and faster
on a busy one. An existing run is used as it is. Clone and policy then fly in process, which gives
the same results as over DDS, bit for bit. The gain of PPO is the mean difference between policy
and clone over the same starts, with the interval of these paired differences.
"""
from __future__ import annotations

import argparse
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import machine
from benchmarks.experiments.statistics import Estimate
from benchmarks.experiments.statistics import over_seeds
from benchmarks.experiments.training import Recipe
from benchmarks.experiments.training import train as train_in_process
from ppo_agent_node.config.presets import preset_num_envs
from ppo_agent_node.evaluation import conditions_files
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.conditions_files import aligned
from ppo_agent_node.evaluation.conditions_files import percent
from ppo_agent_node.evaluation.conditions_table import fly_table
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots import choice
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.statistics import mean_interval
from ppo_agent_node.statistics import wilson
from rocket_sim_node import worlds

ROOT = Path(__file__).parents[3]
ROCKETS = 500
SEED = 40_000_000
"""seed of the fresh starts"""
_ALIASES = {'scripted': choice.EXPERT}


def train(options: argparse.Namespace, seed: int) -> tuple[Path, float | None]:
    """Train with a seed; return the run and its duration, s, or None if the run existed.

    The duration is wall-clock time, or processor time for a training in this process.

    :raises CalledProcessError: if the training failed.
    """
    name = f'{options.world}-{options.preset}'
    run = options.runs / f'{name}-{seed}'
    if (run / 'evaluation.json').exists():
        return run, None
    if options.in_process:
        num_envs = options.num_envs or preset_num_envs(options.preset, options.world)
        recipe = Recipe(name, options.preset, {}, num_envs, options.world)
        return run, train_in_process(recipe, seed, options.runs).cpu_seconds
    began = time.monotonic()
    subprocess.run(
        [ROOT / 'launch_scripts' / 'train', f'world:={options.world}',
         f'preset:={options.preset}', f'seed:={seed}', f'run_dir:={run}'], check=True,
        stdout=subprocess.DEVNULL)
    return run, time.monotonic() - began


def figures(result: EvaluationResult) -> dict[str, Any]:
    """Return the figures of an evaluation for the table."""
    flown, landed = result.episodes, result.landed
    count = int(landed.sum())
    if not result.is_rocket:
        return {
            'landed': count, 'episodes': len(flown),
            'mean_return': float(flown.episode_return.mean()),
            'mean_return_interval': mean_interval(flown.episode_return),
            'solved': float((flown.episode_return >= 200).mean())}
    speed = flown.touchdown_speed[landed]
    return {
        'landed': count, 'episodes': len(flown),
        'landing_rate_interval': wilson(count, len(flown)),
        'mean_return': float(flown.episode_return.mean()),
        'mean_return_interval': mean_interval(flown.episode_return),
        'fuel_ratio': metrics.fuel_ratio(result),
        'touchdown_speed_p95': float(np.quantile(speed, 0.95)) if count else None,
        'tanks_dry': float((flown.fuel_left <= 0).mean())}


def fly(options: argparse.Namespace, pilot: str | Path, task: str) -> EvaluationResult:
    """Fly a pilot on a task such as `mix:7` from fresh starts, the same ones for each pilot.

    :param pilot: a policy file, or a name as for `evaluate`; `scripted` is the expert.
    """
    name, _, level = task.partition(':')
    settings: dict[str, Any] = {}
    if options.world != 'lunar_lander':
        settings = {'conditions': name, 'observation': 'extended'}
    world = worlds.make(options.world, ROCKETS, **settings)
    chosen: Pilot = (
        PolicyPilot(pilot, world.spec) if isinstance(pilot, Path) else
        choice.choose(_ALIASES.get(pilot, pilot), world.spec, options.seed).pilot)
    return evaluate(
        world, chosen, options.episodes, options.seed,
        **({'level': int(level)} if level else {}))


def gain(clone: EvaluationResult, policy: EvaluationResult) -> dict[str, Any]:
    """Return the mean gain in return of a policy over its clone, from the same starts.

    The interval is that of the paired differences.
    """
    difference = policy.episodes.episode_return - clone.episodes.episode_return
    return {'gain': float(difference.mean()), 'gain_interval': mean_interval(difference)}


def of_all_seeds(
    task: str, flown: Sequence[tuple[EvaluationResult, EvaluationResult]],
) -> dict[str, Any]:
    """Print and return what PPO does to the mean return of several seeds together.

    All fly the same starts, so the returns of a start are averaged over the seeds first. The gain
    has two intervals: one over the starts, for these policies, and Student's over the seeds, for
    further seeds on these starts.

    :param flown: the flights of clone and policy of each training seed.
    """
    clones, policies = (
        np.stack([pair[which].episodes.episode_return for pair in flown]) for which in (0, 1))
    gains = policies - clones
    gain = Estimate(float(gains.mean()), *mean_interval(gains.mean(0)))
    further = over_seeds(gains.mean(1))
    found = {
        'task': task, 'seeds': len(flown), 'gain': gain.value, 'gain_interval': gain[1:],
        'gain_interval_over_seeds': further[1:]}
    means = []
    for name, returns in (('clones', clones), ('policies', policies)):
        mean, (low, high) = float(returns.mean()), mean_interval(returns.mean(0))
        found |= {name: mean, f'{name}_interval': (low, high)}
        means.append(f'{name} {mean:.3f} [{low:.3f}, {high:.3f}]')
    print(f'{len(flown)} seeds together, {task}: {", ".join(means)}, PPO {gain.text(3)}, '
          f'over seeds {further.text(3)}', flush=True)
    return found


def markdown(flown: Sequence[dict[str, Any]]) -> str:
    """Return a Markdown table: one line per pilot, two columns per task."""
    tasks = list(dict.fromkeys(one['task'] for one in flown))
    found = {(one['pilot'], one['task']): one for one in flown}
    heads = [text for task in tasks
             for text in (f'{task.replace(":", ", level ")}: landed', 'mean return')]
    lines = [['pilot', *heads]]
    for pilot in dict.fromkeys(one['pilot'] for one in flown):
        line = [pilot]
        for task in tasks:
            one = found[pilot, task]
            low, high = one['mean_return_interval']
            line += [f'{percent(one["landed"] / one["episodes"])} %',
                     f'{one["mean_return"]:.2f} [{low:.2f}, {high:.2f}]']
        lines.append(line)
    return aligned(lines)


def row(label: str, task: str, one: dict[str, Any]) -> str:
    """Return a line of the printed table."""
    low, high = one['mean_return_interval']
    text = (f'{label:<16} {task:<12} {100 * one["landed"] / one["episodes"]:7.2f} %  '
            f'{one["mean_return"]:8.3f} [{low:.3f}, {high:.3f}]')
    if 'solved' in one:
        return f'{text}  solved {100 * one["solved"]:.2f} %'
    if one['landed']:
        text += f'  fuel {one["fuel_ratio"]:.4f}  p95 {one["touchdown_speed_p95"]:.4f} m/s'
    if 'gain' in one:
        text += f'  PPO {one["gain"]:+.3f} [{one["gain_interval"][0]:+.3f}, ' \
                f'{one["gain_interval"][1]:+.3f}]'
    return f'{text}  dry {100 * one["tanks_dry"]:.2f} %'


def main() -> None:
    """Train and fly the policies, and print and write the figures."""
    parser = argparse.ArgumentParser(prog='bench seeds', description=__doc__)
    parser.add_argument('--world', default='rocket', choices=worlds.names(), help='world')
    parser.add_argument('--preset', default='default', help='preset')
    parser.add_argument(
        '--seeds', type=int, nargs='*', default=[1, 2, 3, 4, 5],
        help='training seeds; none: only the pilots fly')
    parser.add_argument('--tasks', nargs='+', default=['nominal:7', 'nominal:8'],
                        help='conditions and level, such as mix:7; for the lander: nominal')
    parser.add_argument(
        '--pilots', nargs='*', default=['scripted'],
        help='further pilots besides clone and policy: scripted, random, expert_estimator, names '
        'of shipped policies, policy files')
    parser.add_argument('--table', type=int, metavar='LEVEL', help=(
        'also fly all policies under each condition of the table of evaluate, on this level'))
    parser.add_argument('--episodes', type=int, default=10_000, help='episodes for each task')
    parser.add_argument('--seed', type=int, default=SEED, help='seed of the fresh starts')
    parser.add_argument('--runs', type=Path, default=ROOT / 'runs', help='folder of the runs')
    parser.add_argument('--in-process', action='store_true', help='train without nodes')
    parser.add_argument(
        '--num-envs', type=int, help=(
            'number of rockets or landers with --in-process; by default that of the preset'))
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    torch.set_num_threads(1)
    found: dict[str, Any] = {'commit': machine.commit(), 'flown': []}

    def show(
        label: str, task: str, pilot: str | Path, clone: EvaluationResult | None = None,
    ) -> EvaluationResult:
        result = fly(options, pilot, task)
        one = figures(result)
        if clone is not None:
            one |= gain(clone, result)
        found['flown'].append({'pilot': label, 'task': task, **one})
        print(row(label, task, one), flush=True)
        return result

    for name in options.pilots:
        for task in options.tasks:
            show(name, task, name)
    policies: dict[str, Path] = {}
    pairs: dict[str, list[tuple[EvaluationResult, EvaluationResult]]] = {}
    for seed in options.seeds:
        run, seconds = train(options, seed)
        assert RunFolder(run, resume=True).read_config()['training']['seed'] == seed
        kind = ' of processor time' if options.in_process else ''
        print(f'seed {seed}: {run}' + ('' if seconds is None else f', {seconds:.0f} s{kind}'),
              flush=True)
        found[f'seconds_{seed}'] = seconds
        cloned, policy = run / 'cloned.safetensors', run / 'policy.safetensors'
        for task in options.tasks:
            flown = show(f'clone {seed}', task, cloned) if cloned.exists() else None
            better = show(f'policy {seed}', task, policy, flown)
            if flown is not None:
                pairs.setdefault(task, []).append((flown, better))
        policies[f'policy {seed}'] = policy
    found['all_seeds'] = [
        of_all_seeds(task, each) for task, each in pairs.items() if len(each) > 1]
    print(f'\n{markdown(found["flown"])}')
    if options.table:
        world = worlds.make(options.world, ROCKETS, observation='extended')
        found['table'] = fly_table(
            world, {label: PolicyPilot(path, world.spec) for label, path in policies.items()},
            options.episodes, options.seed, (options.table,))
        print(conditions_files.markdown(found['table']))
    if options.output:
        write_json(options.output, found)


if __name__ == '__main__':
    main()
