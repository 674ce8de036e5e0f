# SPDX-License-Identifier: Apache-2.0
"""Set-up names the processes below which it replaces files."""
from __future__ import annotations

import mmap
import os
import subprocess
from pathlib import Path

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'


def noted(venv: Path) -> str:
    """Return what set-up says about the processes that use an environment."""
    script = f'. {SCRIPTS}/setup_steps.sh; venv=$1 built=$1/ws; note_users'
    return subprocess.run(
        ['bash', '-euc', script, '-', venv],
        capture_output=True, text=True, check=True, timeout=20).stderr


def test_processes_that_use_the_environment_are_named(tmp_path: Path) -> None:
    library = tmp_path / 'lib.so'
    library.write_bytes(bytes(mmap.PAGESIZE))
    assert noted(tmp_path) == ''
    with library.open('rb') as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ):
        said = noted(tmp_path)
    assert said.startswith('Note: processes that are running use what is replaced now')
    assert f' {os.getpid()}.' in said
