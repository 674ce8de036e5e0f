# SPDX-License-Identifier: Apache-2.0
"""A small disk for tests, which can be full or read-only; processes that write until killed."""
from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import torch

from ppo_agent_node.runs.folder import RunFolder


def _mount(*arguments: str) -> None:
    subprocess.run(['mount', *arguments], check=True, capture_output=True, text=True, timeout=10)


class Disk:
    """A file system in memory."""

    def __init__(self, path: Path, mebibytes: int) -> None:
        """Mount the file system.

        :raises subprocess.CalledProcessError: if that is not permitted.
        """
        self.path = path
        path.mkdir()
        _mount('-t', 'tmpfs', '-o', f'size={mebibytes}m', 'hoverslam-test', str(path))
        self._filler = path / 'filler'

    def fill(self) -> None:
        """Fill the disk with a file."""
        with contextlib.suppress(OSError), self._filler.open('wb', buffering=0) as file:
            while file.write(bytes(1 << 16)):
                pass

    def free(self) -> None:
        """Remove that file."""
        self._filler.unlink()

    def close(self) -> None:
        """Unmount the disk; its files are lost."""
        subprocess.run(['umount', '--lazy', str(self.path)], check=False, capture_output=True)


@contextlib.contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Make a folder read-only."""
    _mount('--bind', '-o', 'ro', str(folder), str(folder))
    try:
        yield
    finally:
        subprocess.run(['umount', '--lazy', str(folder)], check=True, capture_output=True)


def save_for_ever(path: Path, first: int) -> None:
    """Write checkpoints of a run, each as large as a real one, until killed."""
    folder = RunFolder(path, resume=True)
    with folder.locked():
        for iteration in itertools.count(first):
            tensors = {name: torch.full((256, 256), float(iteration)) for name in 'abcdef'}
            folder.append({'iteration': iteration})
            folder.save_best(tensors, {'iteration': iteration})
            folder.save(iteration, tensors, {'iteration': iteration})


class Writers:
    """Processes that write until killed, one at a time.

    They are forks of a process that has imported all modules, so each starts at once.
    """

    def __init__(self, path: Path) -> None:
        """Start the parent process; nothing is written yet."""
        self._parent = subprocess.Popen(
            [sys.executable, __file__, str(path)], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True, bufsize=1, start_new_session=True)
        self._writer = 0

    def _hear(self) -> str:
        assert self._parent.stdout is not None
        line = self._parent.stdout.readline()
        assert line, 'the parent of the writers has ended'
        return line

    def start(self, first: int) -> None:
        """Start a writer, whose first checkpoint has this number."""
        assert self._parent.stdin is not None
        self._parent.stdin.write(f'{first}\n')
        self._writer = int(self._hear())

    def kill(self) -> None:
        """Kill the writer."""
        os.kill(self._writer, signal.SIGKILL)
        self._hear()

    def close(self) -> None:
        """End the writer and its parent."""
        os.killpg(self._parent.pid, signal.SIGKILL)
        self._parent.communicate()


@contextlib.contextmanager
def writers(path: Path) -> Iterator[Writers]:
    """Yield writers for the folder of a run."""
    several = Writers(path)
    try:
        yield several
    finally:
        several.close()


if __name__ == '__main__':
    for line in sys.stdin:
        writer = os.fork()
        if writer == 0:
            save_for_ever(Path(sys.argv[1]), int(line))
        print(writer, flush=True)
        os.waitpid(writer, 0)
        print('gone', flush=True)
