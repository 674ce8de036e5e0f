# SPDX-License-Identifier: Apache-2.0
"""The next start removes the temporary folders of killed processes."""
from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from rocket_sim_node.scratch_folder import scratch_folder

CHILD = """
from rocket_sim_node.scratch_folder import scratch_folder
with scratch_folder() as folder:
    (folder / 'picture').touch()
    print(folder, flush=True)
    input()
"""


TOMORROW = 86_400.0
"""s from now: the time of a folder that was made before the clock was set back"""


def start() -> tuple[subprocess.Popen[str], Path]:
    """Start a process that has a folder; return both, the folder a while old."""
    child = subprocess.Popen(
        [sys.executable, '-c', CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    folder = Path(child.stdout.readline().strip())
    os.utime(folder, (0, 0))
    return child, folder


def test_folders_of_killed_processes_are_removed(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    monkeypatch.setattr(tempfile, 'tempdir', None)
    killed, left = start()
    killed.kill()
    killed.communicate()
    os.utime(left, 2 * (time.time() + TOMORROW,))
    living, used = start()
    assert not left.exists(), 'the next start has removed it'
    foreign = tmp_path / 'hoverslam-foreign'
    foreign.mkdir()
    os.utime(foreign, (0, 0))
    young = tmp_path / 'hoverslam-young'
    young.mkdir()
    (young / 'lock').touch()
    (tmp_path / 'hoverslam-link').symlink_to(used)
    with scratch_folder() as mine:
        assert mine.parent == tmp_path
        assert (used / 'picture').exists(), 'its process lives'
        assert foreign.exists(), 'it has no lock of ours'
        assert young.exists(), 'its process may be about to lock it'
    assert not mine.exists()
    living.communicate('\n')
    assert not used.exists()
