# SPDX-License-Identifier: Apache-2.0
"""Commands whose standard streams are closed."""
from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
COMMANDS = [
    'compare', 'evaluate', 'export', 'failures', 'fly', 'land', 'pictures', 'report', 'screenshot',
    'train']


def run(command: str, streams: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ['bash', '-c', f'"$0" --help {streams}', SCRIPTS / command], stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize('command', COMMANDS)
def test_a_closed_standard_output_is_refused_in_one_line(command: str) -> None:
    done = run(command, '>&-')
    assert (done.returncode, done.stderr) == (
        2, f'{command}: standard output: it is closed, expected a terminal, file or pipe\n')


@pytest.mark.parametrize('streams', ['<&-', '2>&-', '<&- 2>&-'])
def test_a_command_runs_with_other_streams_closed(streams: str) -> None:
    done = run('compare', streams)
    assert done.returncode == 0
    assert done.stdout.startswith('Usage: ') and not done.stderr
