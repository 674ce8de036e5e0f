# SPDX-License-Identifier: Apache-2.0
"""`launch_scripts/test` with a stand-in for pytest."""
from __future__ import annotations

import shutil
import signal
import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
_PYTEST = """#!/usr/bin/env bash
trap 'kill $!; exit 2' INT
echo ready
sleep 30 > /dev/null &
wait
"""


@pytest.mark.parametrize(('first', 'second'), [
    ('--smoke', '--nightly'), ('--fast', '--smoke'), ('--nightly', '--fast')])
def test_only_one_kind_of_run_can_be_chosen(first: str, second: str) -> None:
    done = subprocess.run(
        [SCRIPTS / 'test', first, second], capture_output=True, text=True, check=False, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (
        2, '', f'test: got {first} and {second}, expected one of --fast, --smoke and --nightly\n')


@pytest.mark.parametrize(('number', 'status'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_interrupts_pytest_and_sets_the_status(
        tmp_path: Path, number: signal.Signals, status: int) -> None:
    scripts = tmp_path / 'launch_scripts'
    scripts.mkdir()
    for name in ('test', 'attend.sh', 'streams.sh'):
        shutil.copy(SCRIPTS / name, scripts)
    (scripts / 'python').write_text(_PYTEST)
    (scripts / 'python').chmod(0o755)
    (scripts / 'env.sh').write_text(f'PATH={scripts}:$PATH\n')
    run = subprocess.Popen([scripts / 'test', 'tests/unit'], stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    assert run.stdout.readline() == 'ready\n'
    run.send_signal(number)
    run.communicate(timeout=20)
    assert run.returncode == status
