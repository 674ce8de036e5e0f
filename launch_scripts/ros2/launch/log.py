# SPDX-License-Identifier: Apache-2.0
"""Where the lines of a launch go: the screen, and launch.log in a folder of this run."""
from __future__ import annotations

import contextlib
import datetime
import io
import os
import socket
import sys
import time
from pathlib import Path


def new_folder() -> Path:
    """Return a path for the logs of this run, below ROS_LOG_DIR, ROS_HOME/log or ~/.ros/log."""
    base = os.environ.get('ROS_LOG_DIR')
    if base:
        root = Path(base).expanduser()
    else:
        root = Path(os.environ.get('ROS_HOME') or '~/.ros').expanduser() / 'log'
    now = datetime.datetime.now().strftime('%Y-%m-%d-%H-%M-%S-%f')
    return root / f'{now}-{socket.gethostname()}-{os.getpid()}'


class Log:
    """The lines of one launch."""

    def __init__(self, folder: Path) -> None:
        """Make the folder and launch.log, and let the link `latest` point there."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        if isinstance(sys.stdout, io.TextIOWrapper):
            # Text that the terminal cannot show must not end the process that passes it on.
            sys.stdout.reconfigure(errors='backslashreplace')
        self.quiet = False
        self._file = (folder / 'launch.log').open('a', encoding='utf-8', buffering=1)
        latest = folder.parent / 'latest'
        spare = folder.parent / f'.latest-{os.getpid()}'
        try:
            spare.symlink_to(folder.name)
            spare.replace(latest)
        except OSError:
            # The link is a convenience; two launches may race for it.
            spare.unlink(missing_ok=True)

    def message(self, level: str, name: str, text: str) -> None:
        """Log a line of the launch itself."""
        self._write(f'[{level}] [{name}]: {text}')
        if not self.quiet or level != 'INFO':
            self.screen(f'[{level}] [{name}]: {text}')

    def output(self, name: str, line: str, to_screen: bool, to_file: bool) -> None:
        """Log a line that a process printed."""
        if to_file:
            self._write(f'[{name}] {line}')
        if to_screen:
            self.screen(f'[{name}] {line}')

    def _write(self, text: str) -> None:
        """Write a line to the file; a full disk must not keep the launch from ending its nodes."""
        with contextlib.suppress(OSError):
            self._file.write(f'{time.time():.7f} {text}\n')

    def header(self) -> None:
        """Print what the real command begins with."""
        self.message('INFO', 'launch', f'All log files can be found below {self.folder}')
        self.message('INFO', 'launch', 'Default logging verbosity is set to INFO')

    @staticmethod
    def screen(text: str) -> None:
        """Print a line; a reader or terminal that went away must not end the launch."""
        try:
            print(text, flush=True)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):
            self._file.close()
