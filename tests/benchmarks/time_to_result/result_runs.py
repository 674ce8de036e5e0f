# SPDX-License-Identifier: Apache-2.0
"""The runs of `bench result`, from the start of their processes to a passing evaluation."""
from __future__ import annotations

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
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.ppo.policies.file import POLICY
from ppo_agent_node.runs import sealed_file
from ppo_agent_node.runs.config_file import read_config
from rocket_sim_node import worlds

LANDERS = 128
"""flown at once, what the preset is made for; an evaluation is one flight of all"""
SIMULATORS = 1
"""among which they are shared; two are no faster, as the agent is what is busy"""
NEEDED_RATE = 0.99
"""of the rockets have to land"""
_POLL = 0.01
"""s between two looks at a log"""
_AFTERWARDS = 600.0
"""s that what follows a run, and is not timed, may take"""


def follow(path: Path, process: Process, end: float) -> Iterator[dict[str, Any]]:
    """Yield the JSON objects that are written to a file, a line each, until a time is over.

    :param process: the one that writes.
    :param end: CLOCK_MONOTONIC, s.
    :raises AssertionError: with its log, when it ended before.
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
    """Yield what starts processes, and the time; end them at last."""
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        try:
            yield processes, time.monotonic()
        finally:
            processes.end()


Start = Callable[[Processes], tuple[Process, Path]]
"""Starts the processes of a run; returns the one that learns, and where it writes lines."""


@contextmanager
def begun(start: Start) -> Iterator[tuple[Process, Path, float]]:
    """Yield a run that has just been started, and when it was; end it at last.

    It is started once before, until its first line: how long a disk takes to deliver libraries
    that are not in memory, up to half a minute, says nothing about the program that needs them.
    """
    with started() as (processes, now):
        process, log = start(processes)
        next(follow(log, process, now + _AFTERWARDS), None)
    with started() as (processes, now):
        process, log = start(processes)
        yield process, log, now


def peer(module: str, seed: int, options: Options) -> TimedRun:
    """Run a peer that learns in one process."""
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
    simulators: int, simulator: dict[str, object], agent: dict[str, object],
) -> Start:
    """Return what starts our nodes with these parameters, preset `quick`."""
    def start(processes: Processes) -> tuple[Process, Path]:
        folder = processes.folder / 'run'
        for number in range(simulators):
            processes.run_node(
                'rocket_sim_node', 'simulator', (f'__ns:=/sim_{number}',), **simulator)
        return processes.run_node(
            'ppo_agent_node', 'ppo_agent', run_dir=folder, preset='quick', simulators='/sim_*',
            num_groups=simulators, **agent,
        ), folder / 'train.jsonl'

    return start


def ours(seed: int, options: Options) -> TimedRun:
    """Run our simulator and our agent, as nodes that talk over DDS."""
    run = TimedRun('ours', seed)
    start = nodes(SIMULATORS, {'world': 'lunar_lander', 'num_envs': LANDERS // SIMULATORS}, {
        'seed': seed, 'target_return': options.target, **options.extra})
    with begun(start) as (agent, log, began):
        folder, learning = log.parent, 0.0
        for line in follow(log, agent, began + options.cap):
            learning += line['seconds']
            if 'selection_return' not in line:
                continue
            run.settings = training = read_config(folder / 'config.yaml')['training']
            run.evaluations.append(Point(
                time.monotonic() - began, line['iteration'] * training['n_steps'] * LANDERS,
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
    """Return after which iteration a policy was saved; -1 when there is none."""
    if not path.exists():
        return -1
    return int(sealed_file.read(path, POLICY).content['training']['iteration'])


CONTESTANTS: dict[str, Callable[[int, Options], TimedRun]] = {
    'ours': ours,
    'envpool_ppo': lambda seed, options: peer('envpool_ppo', seed, options),
    'sb3_lander': lambda seed, options: peer('sb3_lander', seed, options),
}
"""Contestants that learn to fly the lander, by name."""


def rocket(seed: int, cap: float, extra: dict[str, str]) -> TimedRun:
    """Run the rocket's quick preset from nothing to its evaluation of 2 000 fresh starts."""
    run = TimedRun('rocket', seed)
    with begun(nodes(1, {}, {'seed': seed, **extra})) as (agent, log, began):
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
