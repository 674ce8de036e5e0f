# SPDX-License-Identifier: Apache-2.0
"""Real processes for tests: started with their own log, ended by id, never left behind."""
from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

TESTS = str(Path(__file__).parents[1])
"""where programs of ours find package `support`"""
_FIRST_DOMAIN = 20
_DOMAINS = 80


class Process:
    """A child in a process group of its own, whose output goes to a file."""

    def __init__(self, command: list[str], log: Path, env: dict[str, str]) -> None:
        """Start it."""
        self.log = log
        self.command = command
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
        """Whether it has not ended yet."""
        return self._child.poll() is None

    def output(self) -> str:
        """Return all it has printed."""
        return self.log.read_text(errors='replace')

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the whole group."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def wait(self, seconds: float) -> int:
        """Return the exit status.

        :raises AssertionError: with the log, when it has not ended in time.
        """
        try:
            return self._child.wait(seconds)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f'{self.command} still runs after {seconds} s:\n{self.output()}') from None

    def wait_for(self, text: str, seconds: float) -> None:
        """Wait until it has printed `text`.

        :raises AssertionError: with the log, when it has not in time, or has ended.
        """
        wait_until(
            lambda: text in self.output() or not self.running, seconds,
            lambda: f'{self.command} did not print {text!r}:\n{self.output()}')
        assert text in self.output(), f'{self.command} ended without {text!r}:\n{self.output()}'

    def end(self, asked: bool = False) -> None:
        """End it, kindly at first.

        :param asked: whether it was asked kindly already.
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
    """Wait until `done()`.

    :raises AssertionError: with the complaint, when the time is over.
    """
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, complaint() or f'not done after {seconds} s'
        time.sleep(0.02)


def ros_args(remap: tuple[str, ...] = (), **parameters: object) -> list[str]:
    """Return the arguments of a node that say what is remapped, and its parameters."""
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
    """Return what keeps a ROS domain from all other tests of this machine until it is closed.

    A name that the kernel forgets with the process that has it; None where another has it.
    """
    kept = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        kept.bind(f'\0hoverslam-test-domain-{domain}')
    except OSError:
        kept.close()
        return None
    return kept


class Processes:
    """All processes of one test, in a ROS domain of their own."""

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
        """Start a process of this test, with environment variables of its own."""
        log = self.folder / f'process_{len(self._started)}.log'
        process = Process(list(command), log, {**self.env, **variables})
        self._started.append(process)
        return process

    def run_node(
        self, package: str, executable: str, remap: tuple[str, ...] = (), **parameters: object,
    ) -> Process:
        """Start a node with `ros2 run`."""
        return self.start('ros2', 'run', package, executable, *ros_args(remap, **parameters))

    def logs(self) -> str:
        """Return what all of them printed."""
        return '\n'.join(
            f'--- {" ".join(p.command)} (pid {p.pid})\n{p.output()}' for p in self._started)

    def end(self) -> None:
        """End all of them: kindly, and at the same time, at first."""
        try:
            for process in self._started:
                process.signal(signal.SIGINT)
            for process in self._started:
                process.end(asked=True)
        finally:  # also when the time of the test is over
            for process in self._started:
                process.signal(signal.SIGKILL)
            self._release()

    def _release(self) -> None:
        if self._reserved:
            self._reserved.close()
            self._reserved = None
