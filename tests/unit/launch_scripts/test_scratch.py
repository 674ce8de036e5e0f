# SPDX-License-Identifier: Apache-2.0
"""Scratch folders of the commands: gone with them, or with the next start if they are killed."""
from __future__ import annotations

import os
import signal
import subprocess
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


def test_only_folders_of_killed_scripts_are_removed(tmp_path: Path) -> None:
    killed, left = start(tmp_path)
    killed.send_signal(signal.SIGKILL)
    killed.communicate(timeout=20)
    os.utime(left, LONG_AGO)
    kept = [tmp_path / name for name in ('hoverslam-abcdef', 'hoverslam-mine', 'other')]
    for folder in kept:
        folder.mkdir()
        os.utime(folder, LONG_AGO)
    (tmp_path / 'hoverslam-lnlnln').symlink_to(kept[2])
    assert left.exists()
    living, used = start(tmp_path)
    assert not left.exists()
    another, its = start(tmp_path)
    assert used.exists(), 'its script lives'
    end(another)
    end(living)
    assert not used.exists() and not its.exists()
    assert all(folder.exists() for folder in kept), 'they have no lock of ours'


def test_one_that_has_just_been_made_stays(tmp_path: Path) -> None:
    young = tmp_path / 'hoverslam-aaaaaa'
    young.mkdir()
    (young / 'lock').touch()
    script, _ = start(tmp_path)
    end(script)
    assert young.exists(), 'its script may be about to lock it'


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_script_that_is_told_to_end_removes_its_own(
        tmp_path: Path, number: signal.Signals) -> None:
    script, made = start(tmp_path)
    script.send_signal(number)
    script.communicate(timeout=20)
    assert not made.exists()
