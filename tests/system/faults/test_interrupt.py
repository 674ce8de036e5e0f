# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C during a training: all processes end, and the resumed run ends the same."""
from __future__ import annotations

import json
import os
import re
import shlex
import signal
from pathlib import Path

import pytest
from support.processes import Process
from support.processes import Processes
from support.training.training_runs import LOW
from support.training.training_runs import SMALL
from support.training.training_runs import assert_same_run
from support.training.training_runs import evaluate_in_process
from support.training.training_runs import train_in_process
from support.users.pseudo_terminal import PseudoTerminal

TRAIN = str(Path(__file__).parents[3] / 'launch_scripts' / 'train')
ARGUMENTS = ('num_envs:=8', *(
    f'{name}:={value}' for name, value in {**SMALL, **LOW, 'plots': True}.items()))
ALONE = ('record:=false', 'second_simulator:=')
"""Arguments of a training with one simulator and no recorder."""
STAGES = ('cloning 1/', 'PPO 1/', 'computing figures')
"""Lines after which a run is interrupted; the first begins anew, having saved nothing."""

pytestmark = pytest.mark.timeout(600)


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


def assert_stopped_well(process: Process, run: Path, status: int, count: int) -> None:
    """Assert that all processes ended without force, and that the last line says how to go on."""
    assert process.wait(60.0) == status, process.output()
    output = process.output()
    assert len(nodes(output)) == count
    assert not [pid for pid in nodes(output) if runs(pid)]
    for word in ('escalating', 'Traceback', 'has died'):
        assert word not in output
    *_, before, last = output.splitlines()
    assert before == 'stopped; continue with:'
    assert last.split()[:3] == [TRAIN, f'run_dir:={run}', 'resume:=true']


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run without an interruption, and without ROS."""
    return evaluate_in_process(
        train_in_process(tmp_path_factory.mktemp('undisturbed') / 'run'))


def test_a_run_interrupted_at_every_stage_ends_the_same(
        processes: Processes, tmp_path: Path, undisturbed: Path) -> None:
    run = tmp_path / 'run'
    arguments: tuple[str, ...] = (f'run_dir:={run}', *ARGUMENTS)
    for number, line in enumerate(STAGES):
        # Once with the recorder and, where there are two cores, a second simulator.
        many = number == 1
        process = train(
            processes, *(['record:=true'] if many else ALONE), *arguments)
        process.wait_for(line, 90.0)
        process.signal(signal.SIGINT)
        if number % 2 == 0:
            # Impatience, or a launch that passes on what the terminal sent already.
            process.signal(signal.SIGINT)
        assert_stopped_well(process, run, 130, 3 + (os.cpu_count() > 1) if many else 2)
        arguments = (f'run_dir:={run}', 'resume:=true')
    last = train(processes, *ALONE, *arguments)
    assert last.wait(120.0) == 0, processes.logs()
    assert last.output().splitlines()[-1] == f'run: {run}'
    # Trained to the end already: only the evaluation was done again.
    assert 'PPO 4/4: level' not in last.output()
    assert 'PPO 4/4: resumed from iteration_000004' in last.output()
    assert 'evaluating 20/20' in last.output()
    assert_same_run(run, undisturbed)
    # As numbers: what was 4 in the world itself is 4.0 over the wire.
    ours, theirs = (
        json.loads((folder / 'evaluation.json').read_text()) for folder in (run, undisturbed))
    assert ours == theirs


def test_the_advice_after_an_early_interrupt_has_all_settings(
        processes: Processes, tmp_path: Path) -> None:
    run = tmp_path / 'a run'
    process = train(processes, f'run_dir:={run}', 'world:=rocket_planar', 'seed:=7')
    process.wait_for('process started with pid', 30.0)
    # The agent is still on its way: it left no mark of the run.
    assert not (run / 'config.yaml').exists()
    process.signal(signal.SIGTERM)
    assert process.wait(60.0) == 143, process.output()
    assert not [pid for pid in nodes(process.output()) if runs(pid)]
    before, advice = process.output().splitlines()[-2:]
    assert before == 'stopped before the run began; start it again with:'
    assert shlex.split(advice) == [TRAIN, f'run_dir:={run}', 'world:=rocket_planar', 'seed:=7']


def test_on_a_terminal_nothing_but_the_display_is_shown(
        processes: Processes, tmp_path: Path, terminal: PseudoTerminal) -> None:
    run = tmp_path / 'run'
    child = terminal.start(TRAIN, f'run_dir:={run}', *ARGUMENTS, env=processes.env)
    terminal.wait_for('1/4 iterations', 90.0)
    terminal.press(b'\x03')
    assert child.wait(60.0) == 130, terminal.text
    terminal.wait_for('resume:=true', 5.0)
    plain = terminal.text
    assert '▶ expert flies' in plain
    assert '✓ cloning   ▶ PPO   · evaluating' in plain
    for other in ('[INFO]', '[launch]', '[ppo_agent', '[simulator', 'Traceback'):
        assert other not in plain
    assert plain.rstrip().splitlines()[-2:] == [
        'stopped; continue with:', f'  {TRAIN} run_dir:={run} resume:=true']


def test_a_file_of_settings_and_settings_beside_it_are_refused(processes: Processes) -> None:
    process = train(processes, 'agent_settings:=mine.yaml', 'seed:=7')
    assert process.wait(30.0) == 2
    assert process.output() == (
        "train: agent_settings: got a file and 'seed' beside it, expected one of the two\n")
