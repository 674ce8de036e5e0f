# SPDX-License-Identifier: Apache-2.0
"""The runs of `bench result`, from the start of their processes to a passing evaluation."""
from __future__ import annotations

import functools
import json
import math
import tempfile
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

from benchmarks.evaluation import gymnasium_lander
from benchmarks.time_to_result.result_lines import VERIFICATION_SEED
from benchmarks.time_to_result.result_records import Options
from benchmarks.time_to_result.result_records import Point
from benchmarks.time_to_result.result_records import TimedRun
from ppo_agent_node.config.presets import preset_num_envs
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.ppo.policies.file import POLICY
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.config_file import read_config
from rocket_sim_node import worlds

OURS = {'ours': 'quick', 'ours_from_scratch': 'from_scratch'}
"""presets of our contestants in the lander, by name; each run has one simulator with the preset's
number of landers, as two are not faster: the agent is the bottleneck"""
ROCKETS, ROCKET_SIMULATORS = 256, 2
"""number of rockets, for which the preset is made; it trains on two levels, one a simulator"""
NEEDED_RATE = 0.99
"""required landing rate of the rockets"""
_POLL = 0.01
"""s between two reads of a log"""
_AFTERWARDS = 600.0
"""time limit of the untimed work before and after a run, s"""


def follow(path: Path, process: Process, end: float) -> Iterator[dict[str, Any]]:
    """Yield the JSON objects that are written to a file, one per line, until a given time.

    :param process: the process that writes them.
    :param end: CLOCK_MONOTONIC, s.
    :raises AssertionError: with the log of the process, if it ends before.
    """
    read, rest = 0, b''
    while time.monotonic() < end:
        running = process.running
        if path.exists():
            with path.open('rb') as file:
                file.seek(read)
                new = file.read()
            read += len(new)
            *lines, rest = (rest + new).split(b'\n')
            yield from (json.loads(line) for line in lines if line.startswith(b'{'))
            if new:
                continue
        assert running, f'{process.command} ended:\n{process.output()}'
        time.sleep(_POLL)


@contextmanager
def started() -> Iterator[tuple[Processes, float]]:
    """Yield an object that starts processes, and the time; at exit, end the processes."""
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        try:
            yield processes, time.monotonic()
        finally:
            processes.end()


Start = Callable[[Processes], tuple[Process, Path]]
"""Starts the processes of a run; returns the one that learns, and the file of its lines."""


@contextmanager
def begun(start: Start) -> Iterator[tuple[Process, Path, float]]:
    """Start a run; yield its process, its file and the time of its start; at exit, end it.

    It is started once before, until its first line, so that its libraries are in memory. Reading
    them from a disk can take half a minute, which is no property of the program.
    """
    with started() as (processes, now):
        process, log = start(processes)
        next(follow(log, process, now + _AFTERWARDS), None)
    with started() as (processes, now):
        process, log = start(processes)
        yield process, log, now


def peer(module: str, seed: int, options: Options) -> TimedRun:
    """Run a peer, which learns in one process."""
    run = TimedRun(module, seed)

    def start(processes: Processes) -> tuple[Process, Path]:
        process = processes.start(
            'python', '-m', f'benchmarks.time_to_result.{module}', '--seed', str(seed), '--target',
            str(options.target), '--verify', str(options.verify))
        return process, process.log

    with begun(start) as (process, log, began):
        first = math.nan
        for line in follow(log, process, began + options.cap):
            if line['event'] == 'first_step':
                first = line['at']
            elif line['event'] == 'evaluation':
                run.evaluations.append(
                    Point(line['at'] - began, line['steps'], line['mean_return']))
                if line['mean_return'] >= options.target:
                    run.passed = True
                    run.seconds, run.learning_seconds = line['at'] - began, line['at'] - first
                    break
        if not run.passed:
            run.seconds = run.learning_seconds = options.cap
        elif options.verify:
            for line in follow(log, process, time.monotonic() + _AFTERWARDS):
                if line['event'] == 'verified':
                    run.gymnasium = {
                        name: line[name] for name in ('mean_return', 'deviation', 'episodes')}
                    break
    return run


def nodes(
    preset: str, simulators: int, simulator: dict[str, object], agent: dict[str, object],
) -> Start:
    """Return a function that starts our nodes with a preset and these parameters."""
    def start(processes: Processes) -> tuple[Process, Path]:
        folder = processes.folder / 'run'
        for number in range(simulators):
            processes.run_node(
                'rocket_sim_node', 'simulator', (f'__ns:=/sim_{number}',), **simulator)
        return processes.run_node(
            'ppo_agent_node', 'ppo_agent', run_dir=folder, preset=preset, simulators='/sim_*',
            num_groups=simulators, **agent,
        ), folder / 'train.jsonl'

    return start


def ours(contestant: str, seed: int, options: Options) -> TimedRun:
    """Run our simulator and our agent as nodes over DDS."""
    run, preset = TimedRun(contestant, seed), OURS[contestant]
    landers = preset_num_envs(preset, 'lunar_lander')
    start = nodes(preset, 1, {'world': 'lunar_lander', 'num_envs': landers}, {
        'seed': seed, 'target_return': options.target, **options.extra})
    with begun(start) as (agent, log, began):
        folder, learning, imitation = log.parent, 0.0, 0
        for line in follow(log, agent, began + options.cap):
            learning += line['seconds']
            if line['stage'] != 'finetune':
                imitation = line['steps']
            if 'selection_return' not in line:
                continue
            run.settings = training = read_config(folder / 'config.yaml')['training']
            run.evaluations.append(Point(
                time.monotonic() - began,
                imitation + line['iteration'] * training['n_steps'] * landers,
                line['selection_return'], line['selection_landing_rate']))
            if line['selection_return'] >= options.target:
                run.passed = True
                run.seconds, run.learning_seconds = run.evaluations[-1].seconds, learning
            if run.passed or line['iteration'] >= training['iterations']:
                break
        if run.passed:
            path = folder / 'policy.safetensors'
            iteration = line['iteration']
            wait_until(lambda: saved_iteration(path) == iteration, 60.0, agent.output)
            if options.verify:
                spec = worlds.make('lunar_lander').spec
                flown = gymnasium_lander.fly(
                    PolicyPilot(path, spec), options.verify, VERIFICATION_SEED)
                run.gymnasium = {
                    'mean_return': float(flown.episode_return.mean()),
                    'deviation': float(flown.episode_return.std()),
                    'episodes': len(flown.episode_return)}
        else:
            run.seconds = run.learning_seconds = options.cap
    return run


def saved_iteration(path: Path) -> int:
    """Return the iteration of a saved policy; -1 if there is none."""
    if not path.exists():
        return -1
    return int(tensor_file.read(path, POLICY).content['training']['iteration'])


CONTESTANTS: dict[str, Callable[[int, Options], TimedRun]] = {
    **{name: functools.partial(ours, name) for name in OURS},
    'envpool_ppo': lambda seed, options: peer('envpool_ppo', seed, options),
    'sb3_lander': lambda seed, options: peer('sb3_lander', seed, options),
}
"""Contestants that learn to fly the lander, by name."""


def rocket(seed: int, cap: float, extra: dict[str, str]) -> TimedRun:
    """Train the rocket with preset `quick`, up to its evaluation on 2 000 fresh starts."""
    run = TimedRun('rocket', seed)
    start = nodes('quick', ROCKET_SIMULATORS, {'num_envs': ROCKETS // ROCKET_SIMULATORS}, {
        'seed': seed, **extra})
    with begun(start) as (agent, log, began):
        folder, end = log.parent, began + cap
        found = folder / 'evaluation.json'
        for line in follow(log, agent, end):
            if 'selection_return' in line:
                run.evaluations.append(Point(
                    time.monotonic() - began, line['steps'], line['selection_return'],
                    line['selection_landing_rate']))
                run.settings = read_config(folder / 'config.yaml')['training']
                if line['iteration'] >= run.settings['iterations']:
                    break
        while not found.exists() and agent.running and time.monotonic() < end:
            time.sleep(_POLL)
        run.seconds = time.monotonic() - began
        if found.exists():
            figures = json.loads(found.read_text('utf-8'))
            run.evaluations.append(Point(
                run.seconds, run.evaluations[-1].steps, figures['mean_return'],
                figures['landing_rate']))
            run.passed = figures['landing_rate'] >= NEEDED_RATE
    return run
