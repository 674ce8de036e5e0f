# SPDX-License-Identifier: Apache-2.0
"""Wrapper of the Rerun program, which repairs, verifies and serves recordings."""
from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

LOCAL = '127.0.0.1'
_PR_SET_PDEATHSIG = 1
PATIENCE = 60.0
"""Base time limit of an operation on a file, s."""
SLOWEST = 2e6
"""Minimum throughput, bytes/s, that extends the time limit by the file's size."""


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


_LIKE_US = _die_with_parent if sys.platform == 'linux' else None
"""Executed first in a child process, so that it ends with its parent in any case."""


_TOLD = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals by which others stop a program, as opposed to crashes on a damaged file."""


class ViewerError(RuntimeError):
    """The Rerun program is missing or failed."""


class ViewerEnded(ViewerError):
    """The program is missing or was stopped from outside; another attempt may succeed."""


def binary() -> Path:
    """Return the native program of the installed package.

    The console script of the same name would leave it orphaned when stopped.

    :raises ViewerEnded: when it is missing.
    """
    try:
        import rerun_cli  # type: ignore[import-untyped]  # it has no types
    except ImportError as error:
        raise ViewerEnded(
            'the Rerun program is missing: pip install rerun-sdk (its version is pinned in the '
            'lock file)') from error
    path = Path(str(rerun_cli.__file__)).parent / 'rerun'
    if not path.is_file():
        raise ViewerEnded(f'the Rerun program is missing: no file {path}')
    return path


def environment() -> dict[str, str]:
    """Return an environment in which it asks nothing, stores no state and sends no telemetry.

    It reports usage over the network (`rerun analytics`), unless `CI` is set.
    """
    return {
        **os.environ, 'RERUN_APP_ONLY': 'true', 'CI': 'true', 'RUST_LOG': 'error', 'NO_COLOR': '1'}


def rrd(*arguments: str | Path) -> None:
    """Run `rerun rrd …`.

    :raises ViewerError: when it fails, with the last of its output, or exceeds the time limit for
        its files.
    """
    timeout = PATIENCE + sum(
        path.stat().st_size for path in arguments if isinstance(path, Path) and path.is_file()
    ) / SLOWEST
    command = [str(binary()), 'rrd', *map(str, arguments)]
    try:
        result = subprocess.run(
            command, env=environment(), capture_output=True, text=True, timeout=timeout,
            check=False, start_new_session=True,  # Ctrl-C is for this process
            preexec_fn=_LIKE_US)
    except subprocess.TimeoutExpired as error:
        raise ViewerError(f'rerun rrd {arguments[0]}: did not end within {timeout:g} s') from error
    if -result.returncode in _TOLD:
        raise ViewerEnded(f'rerun rrd {arguments[0]}: ended by signal {-result.returncode}')
    if result.returncode != 0:
        said = (result.stderr or result.stdout).strip().splitlines()[-3:]
        raise ViewerError(f'rerun rrd {arguments[0]}: {" ".join(said) or "failed"}')


def verify(path: Path) -> None:
    """Check that a recording is complete and readable.

    :raises ViewerError: when it is not.
    """
    rrd('verify', path)


def repair(broken: Path, repaired: Path) -> None:
    """Write the readable part of a truncated recording to a new file.

    :raises ViewerError: when nothing can be recovered.
    """
    rrd('merge', '--continue-on-error', broken, '-o', repaired)
    verify(repaired)


class Program:
    """The program as a child process that ends with this process in any case."""

    def __init__(self, *arguments: str, **variables: str) -> None:
        """Start it; `variables` are added to its environment.

        :raises ViewerError: when the program is missing.
        """
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by stop()
        self._process = subprocess.Popen(
            [str(binary()), *arguments], env={**environment(), **variables},
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._said,
            start_new_session=True,  # Ctrl-C must not stop it: data is still to come
            preexec_fn=_LIKE_US)

    def said(self, length: int = 600) -> str:
        """Return the beginning of its error output."""
        self._said.seek(0)
        return ' '.join(self._said.read().decode(errors='replace').split())[:length]

    def wait_for(self, ready: Callable[[], bool], what: str, patience: float) -> None:
        """Wait until it is ready.

        :raises ViewerError: when it ends or takes too long.
        """
        deadline = time.monotonic() + patience
        while not ready():
            if self._process.poll() is not None:
                raise ViewerError(f'{what} ended at once: {self.said()}')
            if time.monotonic() > deadline:
                raise ViewerError(f'{what} was not ready after {patience:g} s: {self.said()}')
            time.sleep(0.05)

    def stop(self, patience: float = 1.0) -> None:
        """Stop it, by force if necessary."""
        self._process.terminate()
        try:
            self._process.wait(patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._said.close()


def reachable(host: str, port: int, patience: float = 0.3) -> bool:
    """Return whether a server listens there."""
    try:
        with socket.create_connection((host, port), timeout=patience):
            return True
    except OSError:
        return False


def free_port() -> int:
    """Return an unused port of this machine."""
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])
