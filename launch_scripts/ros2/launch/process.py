# SPDX-License-Identifier: Apache-2.0
"""One process of a launch: start, output, end; it never outlives the launch."""
from __future__ import annotations

import asyncio
import codecs
import collections
import contextlib
import ctypes
import os
import signal
from pathlib import Path

from ros2.launch.actions import ProcessPlan
from ros2.launch.log import Log

_PR_SET_PDEATHSIG = 1
_TAIL = 20
_DRAIN_SECONDS = 1.0
_LOOK_SECONDS = 0.05
_SIGKILL_SECONDS = 5.0  # from SIGTERM

_libc = ctypes.CDLL(None, use_errno=True)


def _die_with_parent() -> None:
    """Ask the kernel to kill this process when the launch dies, even by SIGKILL."""
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _environment() -> dict[str, str]:
    """Return the environment of children: ours, without the wheels' marker of a restart.

    The marker stands for the library path of this interpreter; a node's own may differ.
    """
    return {k: v for k, v in os.environ.items() if k != '_ROS_WHEELS_BOOTSTRAP_COMPLETE'}


class Process:
    """A process in a session of its own, so that a signal reaches its children, too."""

    def __init__(self, plan: ProcessPlan, log: Log, own_terminal: bool, quiet: bool) -> None:
        """Do not start it yet.

        `own_terminal` gives it our terminal; `quiet` keeps stderr off the screen, where another
        process has the terminal.
        """
        self.plan = plan
        self.tail: collections.deque[str] = collections.deque(maxlen=_TAIL)
        self._log = log
        self._own_terminal = own_terminal
        self._quiet = quiet
        self._child: asyncio.subprocess.Process | None = None
        self._asked: signal.Signals | None = None

    async def run(self) -> int:
        """Start it and return its exit status, negative for a signal.

        :raises OSError: when it cannot be started.
        """
        name = self.plan.name
        pipe = None if self._own_terminal else asyncio.subprocess.PIPE
        child = await asyncio.create_subprocess_exec(
            *self.plan.command, env=_environment(),
            stdin=None if self._own_terminal else asyncio.subprocess.DEVNULL,
            stdout=pipe, stderr=pipe, start_new_session=True, preexec_fn=_die_with_parent)
        self._child = child
        self._log.message('INFO', name, f'process started with pid [{child.pid}]')
        if self._asked is not None:  # to end, while it was being made
            self._send(self._asked)
        to_screen = self.plan.output == 'screen'
        readers = [
            asyncio.create_task(self._read(stream, shown))
            for stream, shown in (
                (child.stdout, to_screen), (child.stderr, to_screen or not self._quiet))
            if stream is not None]
        try:
            # Not `wait`, which in Python 3.11 also waits for every process that holds its pipes.
            while child.returncode is None:
                await asyncio.sleep(_LOOK_SECONDS)
            status = child.returncode
        finally:
            self._signal(signal.SIGKILL)
        if readers:
            await asyncio.wait(readers, timeout=_DRAIN_SECONDS)
        for reader in readers:
            reader.cancel()
        self._child = None
        if status == 0:
            self._log.message('INFO', name, f'process has finished cleanly [pid {child.pid}]')
        else:
            # On another process's terminal it is no news that one ended as it was asked to.
            level = 'INFO' if self._asked and self._quiet else 'ERROR'
            self._log.message(
                level, name, f'process has died [pid {child.pid}, exit code {status}, '
                f"cmd '{' '.join(part for part in self.plan.command if part.strip())}'].")
        return status

    async def _read(self, stream: asyncio.StreamReader, to_screen: bool) -> None:
        decoder = codecs.getincrementaldecoder('utf-8')(errors='replace')
        rest = ''
        while chunk := await stream.read(65536):
            *lines, rest = (rest + decoder.decode(chunk)).split('\n')
            for line in lines:
                self._emit(line, to_screen)
        if rest:
            self._emit(rest, to_screen)

    def _emit(self, line: str, to_screen: bool) -> None:
        self.tail.append(line)
        self._log.output(self.plan.name, line, to_screen, self.plan.output == 'log')

    def _signal(self, number: signal.Signals) -> None:
        if self._child is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._child.pid, number)

    async def stop(self) -> None:
        """Ask it to end: SIGINT, later SIGTERM, at last SIGKILL. The caller cancels this."""
        plan = self.plan
        total: float = 0
        for number, seconds, following in (
                (signal.SIGINT, plan.sigterm_timeout, signal.SIGTERM),
                (signal.SIGTERM, _SIGKILL_SECONDS, signal.SIGKILL)):
            self._send(number)
            await asyncio.sleep(seconds)
            total += seconds
            self._log.message(
                'ERROR', plan.name,
                f"process[{plan.name}] failed to terminate '{total}' seconds after receiving "
                f"'{number.name}', escalating to '{following.name}'")
        self._send(signal.SIGKILL)

    def _is_starting(self) -> bool:
        """Return whether it is a Python whose program does not listen to signals yet.

        Python itself catches SIGINT from its start on; nodes catch SIGTERM, too.
        """
        if self._child is None:
            return False
        try:
            text = Path(f'/proc/{self._child.pid}/status').read_text()
            caught = int(text.partition('SigCgt:')[2].split()[0], 16)
        except (OSError, ValueError, IndexError):
            return False
        return [bool(caught >> number - 1 & 1) for number in (signal.SIGINT, signal.SIGTERM)] == [
            True, False]

    def _send(self, number: signal.Signals) -> None:
        self._asked = number
        if number == signal.SIGINT and self._is_starting():
            number = signal.SIGTERM  # of SIGINT it would print a traceback
        if self._child is not None:
            name = self.plan.name
            self._log.message('INFO', name, f"sending signal '{number.name}' to process[{name}]")
            self._signal(number)
