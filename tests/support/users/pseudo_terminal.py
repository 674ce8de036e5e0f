# SPDX-License-Identifier: Apache-2.0
"""A pseudo-terminal for tests of interactive programs."""
from __future__ import annotations

import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import threading
from contextlib import suppress
from functools import lru_cache

from support.processes import wait_until

_ESCAPES = re.compile(r'\x1b(?:\[[0-?]*[ -/]*[@-~]|.)')


@lru_cache(1)
def _plain(output: bytes) -> str:
    """Return output without escape sequences; a test looks more often than a program writes."""
    return _ESCAPES.sub('', output.decode(errors='replace'))


class PseudoTerminal:
    """A terminal of 100 x 30 characters and the programs started in it."""

    def __init__(self) -> None:
        """Open the terminal, and read its output until it is closed."""
        self._master, self._slave = pty.openpty()
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, struct.pack('HHHH', 30, 100, 0, 0))
        self._output = b''
        self.modes = termios.tcgetattr(self._slave)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._children: list[subprocess.Popen[bytes]] = []

    def _read(self) -> None:
        with suppress(OSError):
            while data := os.read(self._master, 65536):
                self._output += data

    def start(self, *command: str, env: dict[str, str]) -> subprocess.Popen[bytes]:
        """Start a program in this terminal, and discard earlier output."""
        self._output = b''
        child = subprocess.Popen(
            command, stdin=self._slave, stdout=self._slave, stderr=self._slave,
            env={**env, 'TERM': 'xterm-256color'}, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0))
        self._children.append(child)
        return child

    def fly(self, env: dict[str, str], **parameters: object) -> subprocess.Popen[bytes]:
        """Start the keyboard pilot and wait until it asks for keys."""
        given = [item for name, value in parameters.items() for item in ('-p', f'{name}:={value}')]
        child = self.start(
            'ros2', 'run', 'ppo_agent_node', 'keyboard_pilot', '--ros-args', *given, env=env)
        self.wait_for('press r to fly')
        return child

    @property
    def output(self) -> str:
        """All output since the last start, unchanged."""
        return self._output.decode(errors='replace')

    @property
    def text(self) -> str:
        """The output without escape sequences."""
        return _plain(self._output)

    @property
    def restored(self) -> bool:
        """Whether modes, main screen and cursor of the terminal are restored."""
        return (
            termios.tcgetattr(self._slave) == self.modes
            and self.output.count('\x1b[?1049h') == self.output.count('\x1b[?1049l')
            and self.output.rfind('\x1b[?25h') >= self.output.rfind('\x1b[?25l'))

    def wait_for(self, text: str, seconds: float = 40.0) -> None:
        """Wait until the text has been shown."""
        wait_until(lambda: text in self.text, seconds, lambda: f'no {text!r} in:\n{self.text}')

    def press(self, keys: bytes) -> None:
        """Press keys."""
        os.write(self._master, keys)

    def hang_up(self) -> None:
        """Close the terminal while its programs run, as a closed window does; they get SIGHUP.

        A program must be producing output: the kernel waits for the reader.
        """
        os.close(self._slave)
        os.close(self._master)
        self._slave = self._master = -1

    def close(self) -> None:
        """End its programs, with SIGTERM and then SIGKILL, and close the terminal."""
        for child in self._children:
            for number in (signal.SIGTERM, signal.SIGKILL):
                if child.poll() is None:
                    with suppress(ProcessLookupError):
                        os.killpg(child.pid, number)
                    with suppress(subprocess.TimeoutExpired):
                        child.wait(10.0)
        if self._master != -1:
            self.hang_up()
