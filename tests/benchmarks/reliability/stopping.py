# SPDX-License-Identifier: Apache-2.0
"""Time from Ctrl-C to the end of the last process, by stage of a training.

The training uses the world's preset with fewer and longer iterations, so that each stage begins
soon and lasts long enough. It is interrupted in the middle of a stage, with all nodes running.
"""
from __future__ import annotations

import argparse
import os
import re
import signal
import statistics
import tempfile
import time
from pathlib import Path

import psutil
from support.processes import Process
from support.processes import Processes

from ppo_agent_node.evaluation.metrics import write_json

TRAIN = str(Path(__file__).parents[3] / 'launch_scripts' / 'train')
SETTINGS = (
    'clone_epochs:=3', 'iterations:=1', 'n_steps:=1024', 'critic_warmup_iterations:=0',
    'selection_interval:=100', 'evaluation_episodes:=1024')
STAGES = {
    'starting': ('process started with pid', 1.5), 'demonstrations': ('expert flies 1/', 0.5),
    'cloning': ('cloning 1/', 0.5), 'roll-out': ('PPO 0/', 0.5), 'update': ('PPO 0/', 0.5),
    'evaluation': ('evaluating ', 0.2), 'plots': ('computing figures', 0.3)}
"""The line that marks a stage, and the time from that line to the interruption, s. For the
update, the simulator must also be idle."""
_STILL = 0.3
"""s of observation; a simulator in use needs processor time in it"""


def alive(group: int) -> bool:
    """Return whether any process of a session is running."""
    for stat in Path('/proc').glob('[0-9]*/stat'):
        try:
            fields = stat.read_text('utf-8').rpartition(')')[2].split()
        except OSError:
            continue
        if int(fields[3]) == group and fields[0] != 'Z':
            return True
    return False


def wait_for_update(process: Process) -> None:
    """Wait until the simulator of a training is idle.

    :raises StopIteration: if there is no simulator.
    """
    simulator = next(
        child for child in psutil.Process(process.pid).children(recursive=True)
        if 'simulator' in ' '.join(child.cmdline()[:4]) and 'launch' not in child.cmdline())
    while True:
        before = simulator.cpu_times()
        time.sleep(_STILL)
        now = simulator.cpu_times()
        if now.user + now.system - before.user - before.system < 0.1 * _STILL:
            return


def interrupt(process: Process) -> float:
    """Send SIGINT; return the time until all processes have ended, s."""
    os.killpg(process.pid, signal.SIGINT)
    start = time.monotonic()
    while process.running or alive(process.pid):
        if time.monotonic() - start > 60.0:
            raise AssertionError(process.output())
        time.sleep(0.005)
    return time.monotonic() - start


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench stopping', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=3, help='number of rounds')
    parser.add_argument(
        '--stages', nargs='+', choices=STAGES, default=list(STAGES), help='stages to interrupt')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    table: dict[str, list[float]] = {}
    rounds = '1 round' if options.rounds == 1 else f'{options.rounds} rounds'
    print(f'seconds from Ctrl-C to the end of the last process, {rounds}')
    print(f'{"stage":<16}{"median":>8}{"most":>8}  saved, and said how to go on')
    for stage in options.stages:
        line, later = STAGES[stage]
        seconds, said = [], 0
        for _ in range(options.rounds):
            with tempfile.TemporaryDirectory() as folder:
                processes = Processes(Path(folder))
                try:
                    process = processes.start(TRAIN, f'run_dir:={folder}/run', *SETTINGS)
                    process.wait_for(line, 300.0)
                    time.sleep(later)
                    if stage == 'update':
                        wait_for_update(process)
                    seconds.append(interrupt(process))
                    said += bool(re.search(
                        r'(continue|start it again) with:\n .* run_dir:=', process.output()))
                finally:
                    processes.end()
        table[stage] = seconds
        print(f'{stage:<16}{statistics.median(seconds):>8.2f}{max(seconds):>8.2f}'
              f'  {said} of {options.rounds}', flush=True)
    if options.output:
        write_json(options.output, table)


if __name__ == '__main__':
    main()
