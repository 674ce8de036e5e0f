# SPDX-License-Identifier: Apache-2.0
"""The commands that README and docs print, run one by one: `test --nightly` runs this file, too.

They run in a folder that has all of the project by links but `runs`, so that what they write is
gone with the test. Those that a test elsewhere runs, or that cannot be run, are left out; see
`support/documented_commands.py`.
"""
from __future__ import annotations

import re
import shutil
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.documented_commands import EVALUATE
from support.documented_commands import FLY
from support.documented_commands import ROOT
from support.documented_commands import TRAIN
from support.documented_commands import Command
from support.documented_commands import commands
from support.documented_commands import extended
from support.documented_commands import kind_of
from support.documented_commands import python_blocks
from support.processes import Process
from support.processes import Processes

RUN = [command for command in commands() if kind_of(command).is_run]
POLICY = 'runs/small/policy.safetensors'
STANDS_FOR = {
    '<name>': 'small', 'rocket-DATE': 'small', 'run_dir:=DIR': 'run_dir:=figures',
    'output:=DIR': 'output:=new-figures', 'policy:=FILE': f'policy:={POLICY}',
    '--policy FILE': f'--policy {POLICY}', '-s FILE': '-s tests/node/connection/test_peers.py',
    'report RUN': 'report runs/small', 'FOLDER': 'compared', 'PART': 'exchange'}
"""Replacements for the placeholders in commands."""
LANDER = 'ppo_agent_node/ppo_agent_node/policies/lunar_lander.safetensors'


def start(processes: Processes, folder: Path, text: str) -> Process:
    """Start a command in a shell of the environment."""
    return processes.start('bash', '-c', f"cd '{folder}' && . launch_scripts/env.sh && {text}")


@pytest.fixture(scope='module')
def project(
        nightly_only: None, tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Path]:
    """The project, with the runs, recordings and files that the commands name."""
    folder = tmp_path_factory.mktemp('project')
    for path in ROOT.iterdir():
        if path.name not in ('runs', '.git'):
            (folder / path.name).symlink_to(path)
    shutil.copy(
        ROOT / 'ppo_agent_node/launch/parameters/simulator.yaml', folder / 'heavy.yaml')
    group = Processes(tmp_path_factory.mktemp('logs'))
    try:
        for text in (
                extended('./launch_scripts/train', f'{TRAIN} record:=true run_dir:=runs/small'),
                f'./launch_scripts/land {FLY} output:=run.rrd',
                f'./launch_scripts/evaluate {EVALUATE} policy:={POLICY} output:=figures'):
            assert start(group, folder, text).wait(200.0) == 0, group.logs()
    finally:
        group.end()
    for name in ('first', 'second', 'a', 'b'):
        shutil.copytree(folder / 'runs' / 'small', folder / 'runs' / name)
    yield folder


@pytest.fixture
def port() -> int:
    """A port that is free."""
    with socket.socket() as found:
        found.bind(('127.0.0.1', 0))
        return int(found.getsockname()[1])


@pytest.mark.parametrize('command', RUN, ids=str)
def test_a_documented_command_runs(
        command: Command, project: Path, processes: Processes, port: int) -> None:
    kind = kind_of(command)
    text = command.text
    for name, value in STANDS_FOR.items():
        text = text.replace(name, value)
    text = extended(text, kind.append).replace('$PORT', str(port)).replace('$LANDER', LANDER)
    if ' transfer ' in text and not (ROOT / '.bench').exists():
        pytest.skip('the peers are missing; ./launch_scripts/bench transfer installs them')
    for beside in kind.beside:
        other = start(processes, project, beside)
        if 'simulator' in beside:
            other.wait_for('waiting for an agent', 60.0)
    process = start(processes, project, text)
    if kind.until:
        process.wait_for(kind.until, 120.0)
        process.signal(signal.SIGINT)
        process.wait(60.0)
    else:
        assert process.wait(280.0) == 0, processes.logs()
    assert 'Traceback' not in process.output(), process.output()


def test_the_python_of_the_tutorial_runs(project: Path, processes: Processes) -> None:
    """As one session, with fewer episodes and a small training; and the reading of a recording."""
    code = '\n'.join(
        code for page, code in python_blocks()
        if page in ('docs/tutorials/python.md', 'docs/how-to/watch-and-record.md'))
    small = ', '.join(
        f'{name}={value}' for name, value in re.findall(r'(\w+):=(\S+)', TRAIN)
        if name not in ('num_envs', 'record'))
    for old, new in (
            ('episodes=1000', 'episodes=16'), ('num_envs=256', 'num_envs=8'), ('(256,', '(8,'),
            ('seed=3)', f'seed=3, {small})')):
        assert old in code, old
        code = code.replace(old, new)
    (project / 'tutorial.py').write_text(code)
    process = start(processes, project, 'python tutorial.py')
    assert process.wait(200.0) == 0, processes.logs()
