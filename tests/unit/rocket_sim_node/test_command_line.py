# SPDX-License-Identifier: Apache-2.0
"""Commands that are not nodes clean up after a signal and print nothing."""
from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from rocket_sim_node import command_line
from rocket_sim_node import settings
from rocket_sim_node.printable import printable_path


@pytest.mark.parametrize('replaced', [(), ('replaced',)])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signalled_command_cleans_up(
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
    assert (run.returncode, said) == (130 if number == signal.SIGINT else 143, '')
    assert not left.exists()


NAMES = ('\x1b[2J7.rrd', '\x9b2J\x07.rrd', "it's\n\\033 \udcff.rrd", 'ü\t\x7f.rrd')
"""names of files that control a terminal"""


@pytest.mark.parametrize('name', NAMES)
def test_a_shown_command_is_printable_and_can_be_pasted(name: str) -> None:
    command = command_line.watch_with(Path(name))
    assert command.isprintable()
    shell = subprocess.run(
        ['bash', '-c', f'printf "%s\\0" {command}'], capture_output=True, timeout=20, check=True)
    assert shell.stdout.split(b'\0')[1] == os.fsencode(name)
    assert printable_path(name) == command.split(' ', 1)[1]


def test_errors_and_results_hold_no_terminal_control_codes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    @dataclass(frozen=True)
    class Options:
        run: str = settings.setting('', '', 'a run')

    def refuse(options: Options) -> str:
        raise ValueError(f'{options.run}: no run')

    monkeypatch.setattr(sys, 'argv', ['compare', 'run:=\x1b[2J\n'])
    for do in (refuse, lambda options: f'written: {options.run}\n'):
        with suppress(SystemExit):
            command_line.run('compare', '', '', Options, do)
    said = capsys.readouterr()
    assert said.err == 'compare:  [2J : no run\n'
    assert said.out == 'written:  [2J\n\n'


@pytest.mark.parametrize('name', ['run.rrd', 'a run #1.rrd', "it's $(x); `y`.rrd"])
def test_the_command_that_shows_a_recording_can_be_pasted(name: str) -> None:
    assert shlex.split(command_line.watch_with(Path(name)))[1:] == [name]
