# SPDX-License-Identifier: Apache-2.0
"""The Rerun program: it repairs and verifies recordings, and serves them as a web page."""
from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

_PR_SET_PDEATHSIG = 1


class ViewerError(RuntimeError):
    """The Rerun program is missing or did not do what was asked."""


def binary() -> Path:
    """Return the native program of the installed package.

    The console script of the same name would leave it orphaned when it is ended.

    :raises ViewerError: when it is not there.
    """
    try:
        import rerun_cli
    except ImportError as error:
        raise ViewerError(
            'the Rerun program is missing: pip install rerun-sdk (its version is pinned in the '
            'lock file)') from error
    path = Path(str(rerun_cli.__file__)).parent / 'rerun'
    if not path.is_file():
        raise ViewerError(f'the Rerun program is missing: no file {path}')
    return path


def environment() -> dict[str, str]:
    """Return an environment in which it neither asks questions nor writes a state."""
    return {**os.environ, 'RERUN_APP_ONLY': 'true', 'RUST_LOG': 'error', 'NO_COLOR': '1'}


def rrd(*arguments: str | Path, timeout: float = 120.0) -> None:
    """Run `rerun rrd …`.

    :raises ViewerError: when it fails, with the last of what it said.
    """
    command = [str(binary()), 'rrd', *map(str, arguments)]
    try:
        result = subprocess.run(
            command, env=environment(), capture_output=True, text=True, timeout=timeout,
            check=False)
    except subprocess.TimeoutExpired as error:
        raise ViewerError(f'rerun rrd {arguments[0]}: no end after {timeout:g} s') from error
    if result.returncode != 0:
        said = (result.stderr or result.stdout).strip().splitlines()[-3:]
        raise ViewerError(f'rerun rrd {arguments[0]}: {" ".join(said) or "failed"}')


def verify(path: Path) -> None:
    """Check that a recording is whole and readable.

    :raises ViewerError: when it is not.
    """
    rrd('verify', path)


def repair(broken: Path, repaired: Path) -> None:
    """Write what can be read of a recording that was cut off to a new file.

    :raises ViewerError: when there is nothing to save.
    """
    rrd('merge', '--continue-on-error', broken, '-o', repaired)
    verify(repaired)


def start(*arguments: str) -> subprocess.Popen[bytes]:
    """Start the program as a child that ends when this process does, however it ends."""
    return subprocess.Popen(
        [str(binary()), *arguments], env=environment(), stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        preexec_fn=_die_with_parent if sys.platform == 'linux' else None)


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def stop(process: subprocess.Popen[bytes], patience: float = 1.0) -> None:
    """End a child, by force when it does not go by itself."""
    process.terminate()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def reachable(host: str, port: int, patience: float = 0.3) -> bool:
    """Return whether somebody listens there."""
    try:
        with socket.create_connection((host, port), timeout=patience):
            return True
    except OSError:
        return False


def wait_for(
    process: subprocess.Popen[bytes], ready: Callable[[], bool], what: str, patience: float,
) -> None:
    """Wait until a child is ready.

    :raises ViewerError: when it ends or takes too long, with what it said last.
    """
    deadline = time.monotonic() + patience
    while not ready():
        if process.poll() is not None:
            said = process.stderr.read().decode(errors='replace') if process.stderr else ''
            raise ViewerError(f'{what} ended at once: {" ".join(said.split())[-400:]}')
        if time.monotonic() > deadline:
            raise ViewerError(f'{what} was not ready after {patience:g} s')
        time.sleep(0.05)
