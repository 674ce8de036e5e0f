# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at a training: all processes end by themselves, and it goes on as if nothing had been."""
from __future__ import annotations

import os
import pty
import re
import select
import signal
import time
from pathlib import Path

import pytest
from processes import Process
from processes import Processes
from processes import wait_until
from training_runs import assert_same_run

TRAIN = str(Path(__file__).parents[2] / 'launch_scripts' / 'train')
SMALL = (
    'num_envs:=8', 'demonstration_episodes:=16', 'clone_epochs:=3', 'hidden_sizes:=[16,16]',
    'iterations:=4', 'n_steps:=64', 'batch_size:=64', 'selection_interval:=4',
    'selection_episodes:=8', 'evaluation_episodes:=16', 'critic_warmup_iterations:=1',
    'checkpoint_interval:=1', 'threads:=1', 'seed:=5',
)
STAGES = ('expert flies 1/', 'cloning 1/', 'PPO 1/', 'evaluating 1/', 'working out figures')
"""Lines after which a run is interrupted; the first two begin anew, having saved nothing."""


def train(processes: Processes, *arguments: str) -> Process:
    """Start a training."""
    return processes.start(TRAIN, *arguments)


def nodes(output: str) -> list[int]:
    """Return the ids of the processes that the launch started."""
    return [int(number) for number in re.findall(r'process started with pid \[(\d+)\]', output)]


def runs(pid: int) -> bool:
    """Tell whether a process runs; not one that has ended and was not asked why."""
    try:
        return 'Z' not in Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0]
    except OSError:
        return False


def assert_stopped_well(process: Process, run: Path, status: int) -> None:
    """Assert that all processes ended without force, and that the last line says how to go on."""
    assert process.wait(30.0) == status, process.output()
    output = process.output()
    assert len(nodes(output)) == 3
    assert not [pid for pid in nodes(output) if runs(pid)]
    for word in ('escalating', 'Traceback', 'has died'):
        assert word not in output
    *_, before, last = output.splitlines()
    assert before == 'stopped; go on with:'
    assert last.split()[:3] == [TRAIN, f'run_dir:={run}', 'resume:=true']


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run without an interruption."""
    folder = tmp_path_factory.mktemp('undisturbed')
    group = Processes(folder)
    run = folder / 'run'
    try:
        assert train(group, f'run_dir:={run}', 'record:=false', *SMALL).wait(120.0) == 0
    finally:
        group.end()
    return run


def test_interrupted_at_every_stage_it_ends_alike(
        processes: Processes, tmp_path: Path, undisturbed: Path) -> None:
    run = tmp_path / 'run'
    arguments: tuple[str, ...] = (f'run_dir:={run}', *SMALL)
    for number, line in enumerate(STAGES):
        process = train(processes, *arguments)
        process.wait_for(line, 90.0)
        process.signal(signal.SIGINT)
        if number % 2:
            # Impatience, or a launch that passes on what the terminal sent already.
            process.signal(signal.SIGINT)
        assert_stopped_well(process, run, 130)
        arguments = (f'run_dir:={run}', 'resume:=true')
    assert 'PPO 4/' not in process.output()
    last = train(processes, *arguments)
    assert last.wait(120.0) == 0, processes.logs()
    assert last.output().splitlines()[-1] == f'run: {run}'
    # Trained to the end already: only the evaluation was done again.
    assert 'PPO 4/4: level' not in last.output()
    assert 'evaluating 16/16' in last.output()
    assert_same_run(run, undisturbed)
    assert (run / 'evaluation.json').read_bytes() == (undisturbed / 'evaluation.json').read_bytes()


def test_interrupted_before_it_began_the_advice_has_all_settings(
        processes: Processes, tmp_path: Path) -> None:
    run = tmp_path / 'a run'
    process = train(processes, f'run_dir:={run}', 'world:=rocket_planar', 'seed:=7')
    process.wait_for('process started with pid', 30.0)
    wait_until(lambda: (run / '.unfinished').exists(), 30.0)
    process.signal(signal.SIGTERM)
    assert process.wait(30.0) == 143, process.output()
    assert not [pid for pid in nodes(process.output()) if runs(pid)]
    advice = process.output().splitlines()[-1]
    assert 'a\\ run resume:=true' in advice
    if not (run / 'config.yaml').exists():
        assert {'world:=rocket_planar', 'seed:=7'} <= set(advice.split())


def test_on_a_terminal_nothing_but_the_display_is_shown(
        processes: Processes, tmp_path: Path) -> None:
    run = tmp_path / 'run'
    pid, terminal = pty.fork()
    if pid == 0:
        os.execvpe(TRAIN, [TRAIN, f'run_dir:={run}', *SMALL], {
            **processes.env, 'TERM': 'xterm-256color', 'COLUMNS': '100', 'LINES': '30'})
    screen, pressed, end = '', False, time.monotonic() + 120.0
    try:
        while time.monotonic() < end:
            if select.select([terminal], [], [], 0.1)[0]:
                try:
                    screen += os.read(terminal, 65536).decode(errors='replace')
                except OSError:
                    break
            if not pressed and '1/4 iterations' in screen:
                pressed = True
                os.write(terminal, b'\x03')
        _, status = os.waitpid(pid, 0)
    finally:
        os.close(terminal)
    assert os.waitstatus_to_exitcode(status) == 130, screen
    plain = re.sub(r'\x1b\[[0-9;?]*[A-Za-z]', '', screen)
    assert '▶ expert flies' in plain
    assert '✓ cloning   ▶ PPO   · evaluating' in plain
    for other in ('[INFO]', '[launch]', '[ppo_agent', '[simulator', 'Traceback'):
        assert other not in plain
    assert plain.rstrip().splitlines()[-2:] == [
        'stopped; go on with:', f'  {TRAIN} run_dir:={run} resume:=true']
