# SPDX-License-Identifier: Apache-2.0
"""A launch as a child process: its start, its end, and what its nodes complained of."""
from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from rocket_sim_node.printable import printable
from rocket_sim_node.wire.dds import security

_PATIENCE = 60.0
"""Seconds from the request to stop until the processes are killed; a recorder may finish a file of
gigabytes, and the launch itself kills nodes that take longer than theirs."""
_DROPPED = ('_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'HOVERSLAM_TERMINAL', 'HOVERSLAM_TRAIN')
"""variables that are for one process or its terminal"""
_LAUNCHER = """import ctypes, os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
if sys.platform == 'linux':
    ctypes.CDLL(None).prctl(1, signal.SIGINT)  # PR_SET_PDEATHSIG: it ends if the server is killed
os.execvp(sys.argv[1], sys.argv[1:])
"""
_COMPLAINT = re.compile(r'(?:\[[^]]*\] )?\[(FATAL|ERROR)\] \[[\d.]+\] \[[^]]*\]: (.*)')


class LaunchProcess:
    """A running launch, whose output goes to a file."""

    def __init__(self, command: Sequence[str], log: Path) -> None:
        """Start it.

        :raises OSError: when no process can be started.
        """
        self._log = log
        self._deadline = math.inf
        with log.open('wb') as file:
            self._child = subprocess.Popen(
                [sys.executable, '-S', '-c', _LAUNCHER, *command], stdin=subprocess.DEVNULL,
                stdout=file, stderr=subprocess.STDOUT, env=_environment(), start_new_session=True)

    @property
    def ended(self) -> bool:
        """Whether it has ended; it is killed if it was asked to and takes too long."""
        if time.monotonic() > self._deadline:
            self.kill()
        return self._child.poll() is not None

    @property
    def failed(self) -> bool:
        """Whether it, or one of its nodes, has failed; a full ROS 2 ends a launch with 0."""
        return self._child.poll() != 0 or any(kind == 'FATAL' for kind, _ in self._complaints())

    def interrupt(self) -> None:
        """Ask it to stop, as Ctrl-C does; once."""
        if self._deadline == math.inf and not self.ended:
            self._deadline = time.monotonic() + _PATIENCE
            self._child.send_signal(signal.SIGINT)

    def kill(self) -> None:
        """End it and its processes at once."""
        with suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()

    def reason(self) -> str:
        """Return in one line why it failed: what a node complained of last, or what was said."""
        if complaints := self._complaints():
            return complaints[-1][1]
        said = [line for line in self._lines() if line.strip()]
        return said[-1] if said else f'exit status {self._child.poll()}'

    def _complaints(self) -> list[tuple[str, str]]:
        """Return level and text of the errors that nodes logged."""
        return [(found[1], found[2]) for found in map(_COMPLAINT.match, self._lines()) if found]

    def _lines(self) -> list[str]:
        return [printable(line) for line in self._log.read_text(errors='replace').splitlines()]


def _environment() -> dict[str, str]:
    """Return the environment of the launch: the server's, without what is its own."""
    env = {name: value for name, value in os.environ.items() if name not in _DROPPED}
    if env.get(security.OVERRIDE) == f'{security.ENCLAVES}/action_server':
        del env[security.OVERRIDE]  # each node takes its own
    return env
