# SPDX-License-Identifier: Apache-2.0
"""Processes for tests: each has its own log, and all are ended at the end of a test."""
from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

from support.forking import ForkedNode

TESTS = str(Path(__file__).parents[1])
"""folder in which our programs find the package `support`"""
_FIRST_DOMAIN = 20
_DOMAINS = 80


class Process:
    """A process in its own process group, with its output in a file."""

    def __init__(
        self, command: list[str], log: Path, env: dict[str, str], forked: bool = False,
    ) -> None:
        """Start the process.

        :param forked: whether the command is `ros2 run` of a node that is to be forked.
        """
        self.log = log
        self.command = command
        self._child: subprocess.Popen[bytes] | ForkedNode
        if forked:
            self._child = ForkedNode(command[2], command[3], command[4:], log, env)
            return
        with log.open('ab') as file:
            self._child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                env=env, start_new_session=True)

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._child.pid

    @property
    def running(self) -> bool:
        """Whether the process is running."""
        return self._child.poll() is None

    def output(self) -> str:
        """Return all output so far."""
        return self.log.read_text(errors='replace')

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the whole group."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def wait(self, seconds: float) -> int:
        """Wait for the end and return the exit status.

        :raises AssertionError: with the log, if the process has not ended in time.
        """
        try:
            return self._child.wait(seconds)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f'{self.command} still runs after {seconds} s:\n{self.output()}') from None

    def wait_for(self, text: str, seconds: float) -> None:
        """Wait until the process has printed `text`.

        :raises AssertionError: with the log, if it does not print it in time or ends before.
        """
        wait_until(
            lambda: text in self.output() or not self.running, seconds,
            lambda: f'{self.command} did not print {text!r}:\n{self.output()}')
        assert text in self.output(), f'{self.command} ended without {text!r}:\n{self.output()}'

    def end(self, asked: bool = False) -> None:
        """End the process with SIGINT or, if that has no effect, with SIGKILL.

        :param asked: whether SIGINT has been sent already.
        """
        for number, seconds in ((signal.SIGINT, 5.0), (signal.SIGKILL, 5.0)):
            if number == signal.SIGKILL or not asked:
                self.signal(number)
            try:
                self._child.wait(seconds)
            except subprocess.TimeoutExpired:
                continue
            return


def wait_until(
    done: Callable[[], bool], seconds: float, complaint: Callable[[], str] = str,
) -> None:
    """Wait until `done()` is true.

    :raises AssertionError: with the text of `complaint`, if the time is over.
    """
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, complaint() or f'not done after {seconds} s'
        time.sleep(0.02)


def ros_args(remap: tuple[str, ...] = (), **parameters: object) -> list[str]:
    """Return the command-line arguments of a node for remappings and parameters."""
    arguments = ['--ros-args', *(item for rule in remap for item in ('-r', rule))]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ['-p', f'{name}:={text}']
    return arguments


def in_use(domain: int) -> bool:
    """Return whether a UDP port of a ROS domain is bound on this machine (RTPS 2.2, 9.6.1.1)."""
    first = 7400 + 250 * domain
    lines = Path('/proc/net/udp').read_text().splitlines()[1:]
    return any(first <= int(line.split()[1].split(':')[1], 16) < first + 250 for line in lines)


def reserve(domain: int) -> socket.socket | None:
    """Return a socket that reserves a ROS domain on this machine until it is closed.

    Its name in the kernel vanishes with the process. Return None if the domain is reserved.
    """
    kept = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        kept.bind(f'\0hoverslam-test-domain-{domain}')
    except OSError:
        kept.close()
        return None
    return kept


class Processes:
    """All processes of one test, in their own ROS domain."""

    _domains = 0

    def __init__(self, folder: Path) -> None:
        """Choose a domain that no recent test of this session and no other process uses."""
        self.folder = folder
        for _ in range(_DOMAINS):
            self.domain = _FIRST_DOMAIN + (os.getpid() + Processes._domains) % _DOMAINS
            Processes._domains += 1
            self._reserved = reserve(self.domain)
            if self._reserved and not in_use(self.domain):
                break
            self._release()
        self._started: list[Process] = []
        self._numbers = itertools.count()

    @property
    def env(self) -> dict[str, str]:
        """Environment of the processes."""
        path = [TESTS, *filter(None, [os.environ.get('PYTHONPATH')])]
        return {
            **os.environ, 'PYTHONPATH': os.pathsep.join(path), 'ROS_DOMAIN_ID': str(self.domain),
            'PYTHONUNBUFFERED': '1', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_LOG_DIR': str(self.folder / 'ros'),
        }

    def start(self, *command: str, **variables: str) -> Process:
        """Start a process of this test, with additional environment variables."""
        return self._start(command, variables)

    def _start(
        self, command: tuple[str, ...], variables: dict[str, str], forked: bool = False,
    ) -> Process:
        log = self.folder / f'process_{next(self._numbers)}.log'
        process = Process(list(command), log, {**self.env, **variables}, forked)
        self._started.append(process)
        return process

    def run_node(
        self, package: str, executable: str, remap: tuple[str, ...] = (), **parameters: object,
    ) -> Process:
        """Start a node with `ros2 run`."""
        return self.start('ros2', 'run', package, executable, *ros_args(remap, **parameters))

    def fork_node(
        self, package: str, executable: str, remap: tuple[str, ...] = (),
        variables: Mapping[str, str] = MappingProxyType({}), **parameters: object,
    ) -> Process:
        """Start a node as `run_node` does, but forked (see `support.forking`)."""
        return self._start(
            ('ros2', 'run', package, executable, *ros_args(remap, **parameters)),
            {**variables}, forked=True)

    def logs(self) -> str:
        """Return the output of all processes."""
        return '\n'.join(
            f'--- {" ".join(p.command)} (pid {p.pid})\n{p.output()}' for p in self._started)

    def end(self) -> None:
        """End all processes: with SIGINT to all at once, then with SIGKILL."""
        try:
            for process in self._started:
                process.signal(signal.SIGINT)
            for process in self._started:
                process.end(asked=True)
        finally:  # also if the test has timed out
            for process in self._started:
                process.signal(signal.SIGKILL)
            self._release()

    def _release(self) -> None:
        if self._reserved:
            self._reserved.close()
            self._reserved = None
