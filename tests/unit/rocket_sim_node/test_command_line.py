# SPDX-License-Identifier: Apache-2.0
"""Commands that are no nodes: told to end, they tidy up and say nothing."""
from __future__ import annotations

import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rocket_sim_node import command_line


@pytest.mark.parametrize('replaced', [(), ('replaced',)])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_told_to_end_it_tidies_up(
        number: signal.Signals, replaced: tuple[str, ...], tmp_path: Path) -> None:
    left = tmp_path / 'left'
    left.touch()
    code = (
        'import sys, time\n'
        'from pathlib import Path\n'
        'from rocket_sim_node import command_line\n'
        'try:\n'
        '    with command_line.interruptible():\n'
        '        try:\n'
        "            print('ready', flush=True)\n"
        '            time.sleep(60)\n'
        '        except KeyboardInterrupt as error:\n'
        '            if sys.argv[2:]:  # as libraries in C++ do\n'
        "                raise RuntimeError('replaced') from None\n"
        '            raise\n'
        '        finally:\n'
        '            Path(sys.argv[1]).unlink()\n'
        'except OSError:\n'
        '    sys.exit(2)\n')
    run = subprocess.Popen(
        [sys.executable, '-c', code, str(left), *replaced], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE)
    assert run.stdout is not None
    assert run.stdout.readline() == 'ready\n'
    run.send_signal(number)
    _, said = run.communicate(timeout=20)
    assert (run.returncode, said) == (130, '')
    assert not left.exists()


@pytest.mark.parametrize('name', ['run.rrd', 'a run #1.rrd', "it's $(x); `y`.rrd"])
def test_what_shows_a_recording_can_be_pasted_into_a_shell(name: str) -> None:
    assert shlex.split(command_line.watch_with(Path(name)))[1:] == [name]
