# SPDX-License-Identifier: Apache-2.0
"""Scratch folders of the commands are removed at their end, or at the next start after a kill."""
from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
LONG_AGO = (1.0, 1.0)


def start(folder: Path) -> tuple[subprocess.Popen[str], Path]:
    """Start a script that has made its scratch folder, and waits."""
    script = subprocess.Popen(
        ['bash', '-euc', f'here={SCRIPTS}; . "$here/command.sh"; echo "$scratch"; read -r'],
        env={**os.environ, 'TMPDIR': str(folder)}, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True)
    assert script.stdout is not None
    made = Path(script.stdout.readline().strip())
    assert made.parent == folder
    (made / 'file').touch()
    os.utime(made, LONG_AGO)
    return script, made


def end(script: subprocess.Popen[str]) -> None:
    script.communicate('\n', timeout=20)


def test_the_next_start_removes_the_folder_of_a_killed_script(tmp_path: Path) -> None:
    killed, left = start(tmp_path)
    killed.send_signal(signal.SIGKILL)
    killed.communicate(timeout=20)
    living, used = start(tmp_path)
    subprocess.run(
        [sys.executable, '-m', 'ppo_agent_node.commands.launch', SCRIPTS / 'land', '1', used,
         '--help'], stdout=subprocess.DEVNULL, check=True, timeout=60)
    assert not left.exists()
    assert used.exists(), 'its script lives'
    end(living)
    assert not used.exists()


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_terminated_script_removes_its_folder(
        tmp_path: Path, number: signal.Signals) -> None:
    script, made = start(tmp_path)
    script.send_signal(number)
    script.communicate(timeout=20)
    assert not made.exists()


def test_a_file_is_new_although_the_clock_was_set_back(tmp_path: Path) -> None:
    old, replaced, made = (tmp_path / name for name in ('old', 'replaced a', 'made'))
    script = """
        . "$here/command.sh"; note_files "$@"
        sh -c 'for file do echo x > "$file.part"; touch -d 1999-12-31 "$file.part"
            mv "$file.part" "$file"; done' - "${@:2}"
        for file; do is_new "$file" && echo "${file##*/}"; done; ! is_new "$1"
    """
    old.touch()
    replaced.touch()
    found = subprocess.run(
        ['bash', '-uc', script, 'script', old, replaced, made], capture_output=True, text=True,
        check=True, env={**os.environ, 'here': str(SCRIPTS), 'TMPDIR': str(tmp_path)}, timeout=20)
    assert found.stdout.split('\n') == ['replaced a', 'made', '']
