# SPDX-License-Identifier: Apache-2.0
"""Commands whose standard streams are closed."""
from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
COMMANDS = [
    'bench', 'compare', 'evaluate', 'export', 'failures', 'fly', 'land', 'pictures', 'report',
    'screenshot', 'secure', 'setup', 'test', 'train']


def run(command: str, streams: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ['bash', '-c', f'"$0" --help {streams}', SCRIPTS / command], stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize('command', COMMANDS)
def test_a_closed_standard_output_is_refused_in_one_line(command: str) -> None:
    done = run(command, '>&-')
    assert (done.returncode, done.stderr) == (
        2, f'{command}: standard output: it is closed, expected a terminal, file or pipe\n')


def test_every_command_is_tried() -> None:
    found = [path.name for path in SCRIPTS.iterdir() if path.is_file() and not path.suffix]
    assert sorted(found) == COMMANDS


@pytest.mark.parametrize('command', ['compare', 'setup'])
@pytest.mark.parametrize('streams', ['<&-', '2>&-', '<&- 2>&-'])
def test_a_command_runs_with_other_streams_closed(command: str, streams: str) -> None:
    done = run(command, streams)
    assert done.returncode == 0
    assert done.stdout.startswith('Usage: ') and not done.stderr
