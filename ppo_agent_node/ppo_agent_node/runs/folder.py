# SPDX-License-Identifier: Apache-2.0
"""Folder of a training run: settings, log, checkpoints, policy, evaluation, plots."""
from __future__ import annotations

import errno
import fcntl
import json
import math
import os
import re
import tempfile
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path
from typing import IO
from typing import Any

import yaml

from ppo_agent_node.atomic_file import remove_leftovers
from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.runs import run_lock
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs import train_log
from ppo_agent_node.runs.config_file import read_config
from ppo_agent_node.runs.run_lock import UNFINISHED
from ppo_agent_node.runs.tensor_file import TensorFile
from ppo_agent_node.runs.tensor_file import Tensors
from rocket_sim_node import input_file

CHECKPOINT = 'checkpoint'
_NAME = re.compile(r'iteration_(\d{6,})\.safetensors')
_KEPT = 2


class RunFolderError(OSError):
    """A run's folder cannot be used; the message names it and the reason."""


class RunFolder:
    """`config.yaml`, `train.jsonl`, `checkpoints/`, policies and `plots/` of one run.

    `policy` is the best one; `cloned` is the result of behavioural cloning, before fine-tuning.
    """

    def __init__(self, path: Path | str, resume: bool = False) -> None:
        """Create the folder, or open an existing one.

        :param resume: continue an existing run, or begin if there is none.
        :raises RunFolderError: when it cannot be written, or holds a run that is not resumed.
        """
        self.path = Path(path)
        self.config = self.path / 'config.yaml'
        self.log = self.path / 'train.jsonl'
        self.checkpoints = self.path / 'checkpoints'
        self.best = self.checkpoints / 'best.safetensors'
        self.policy = self.path / 'policy.safetensors'
        self.cloned = self.path / 'cloned.safetensors'
        self.plots = self.path / 'plots'
        self._made = not self.path.exists()
        if not resume and self.begun:
            raise RunFolderError(
                f'{self.path}: already holds a run; resume it or name another folder')
        try:
            self.checkpoints.mkdir(parents=True, exist_ok=True)
            if self.plots.exists() and not self.plots.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, 'plots is no folder')
            tempfile.TemporaryFile(dir=self.path).close()
        except OSError as error:
            raise RunFolderError(f'{self.path}: not writable: {error.strerror}') from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder; the system releases the lock when this process dies.

        Incomplete files of a process that died are removed.

        :raises RunFolderError: when another process trains here.
        """
        try:
            lock = run_lock.open_lock(self.path, os.O_RDWR | os.O_CREAT)
        except OSError as error:
            raise RunFolderError(f'{error.filename}: {error.strerror}') from error
        with open(lock, 'wb') as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise RunFolderError(f'{self.path}: another process is training here') from error
            for folder in (self.path, self.checkpoints, self.plots):
                if folder.is_dir():
                    remove_leftovers(folder)
            yield

    @property
    def begun(self) -> bool:
        """Whether there is a run here; its log is created, empty, just before its settings."""
        return self.config.exists() or (self.log.exists() and self.log.stat().st_size > 0)

    @property
    def finished(self) -> bool:
        """Whether a run is complete here, so that at most its evaluation can be resumed."""
        return (
            self.config.exists() and bool(self._saved())
            and not (self.path / UNFINISHED).exists())

    def mark_unfinished(self) -> None:
        """Create the marker that tells the parent process that there is something to resume."""
        os.close(input_file.open_in_place(self.path / UNFINISHED, os.O_RDONLY | os.O_CREAT))

    def mark_finished(self) -> None:
        """Remove the marker."""
        (self.path / UNFINISHED).unlink(missing_ok=True)

    def withdraw(self) -> None:
        """Remove the files of a run that never began."""
        if self.begun:
            return
        self.mark_finished()
        self.log.unlink(missing_ok=True)
        (self.path / run_lock.NAME).unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            self.checkpoints.rmdir()
            if self._made:
                self.path.rmdir()

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.path.name

    def write_config(self, values: dict[str, Any]) -> None:
        """Write all settings.

        :raises OSError: naming the path.
        """
        plain = json.loads(json.dumps(values))
        text = yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)
        write_atomically(self.config, text.encode())

    def read_config(self) -> dict[str, Any]:
        """Return the settings with which the run began, `{}` before it has begun.

        :raises ValueError: when the file is damaged.
        """
        return read_config(self.config)

    def append(self, line: dict[str, Any]) -> dict[str, Any]:
        """Append a line to the log and flush it to the system; non-finite numbers become null.

        :return: the line as it was written.

        :raises OSError: naming the path.
        """
        plain: dict[str, Any] = _without_non_finite(line)
        with self._writing_log(os.O_WRONLY | os.O_APPEND | os.O_CREAT) as file:
            file.write((json.dumps(plain, allow_nan=False) + '\n').encode())
        return plain

    @contextmanager
    def _writing_log(self, flags: int) -> Iterator[IO[bytes]]:
        try:
            with open(input_file.open_in_place(self.log, flags), 'ab') as file:
                yield file
        except OSError as error:
            raise OSError(
                error.errno, f'could not write: {error.strerror}', str(self.log)) from error

    def lines(self) -> list[dict[str, Any]]:
        """Return the log, without a truncated last line."""
        return train_log.read_log(self.log)

    def cut_log(self, count: int) -> None:
        """Truncate the log to its first `count` lines.

        :raises ValueError: when there are fewer.
        """
        lines = input_file.read_bytes(
            self.log, train_log.LARGEST).splitlines(keepends=True) if self.log.exists() else []
        whole = [line for line in lines if line.endswith(b'\n')]
        if len(whole) < count:
            raise ValueError(f'{self.log}: has {len(whole)} lines, expected at least {count}')
        write_atomically(self.log, b''.join(whole[:count]))

    def save(self, iteration: int, tensors: Tensors, content: dict[str, Any]) -> Path:
        """Write the checkpoint of an iteration, and keep the newest two.

        :raises OSError: naming the path; older checkpoints are still there.
        """
        path = self.checkpoints / f'iteration_{iteration:06d}.safetensors'
        if self.log.exists():
            # The checkpoint counts the log's lines: those must be on disk first, in case of a
            # power cut.
            with self._writing_log(os.O_WRONLY | os.O_APPEND) as file:
                os.fsync(file.fileno())
        tensor_file.write(path, CHECKPOINT, tensors, content)
        for old in self._saved()[_KEPT:]:
            old.unlink(missing_ok=True)
        return path

    def save_best(self, tensors: Tensors, content: dict[str, Any]) -> None:
        """Write the checkpoint of the best iteration.

        :raises OSError: naming the path.
        """
        tensor_file.write(self.best, CHECKPOINT, tensors, content)

    def newest(self, warn: Callable[[str], None]) -> tuple[Path, TensorFile] | None:
        """Return the newest valid checkpoint; None if none was ever written.

        :param warn: called with a text for each damaged one.
        :raises ValueError: when there are some and all are damaged.
        """
        saved = self._saved()
        for path in saved:
            try:
                return path, tensor_file.read(path, CHECKPOINT)
            except (ValueError, OSError) as error:
                warn(f'checkpoint ignored: {error}')
        if saved:
            raise ValueError(f'{self.checkpoints}: all {len(saved)} checkpoints are damaged')
        return None

    def go_on_from(self, path: Path) -> None:
        """Rename newer checkpoints, which were skipped as damaged.

        If one became readable again later, it would belong to another history of the run.
        """
        saved = self._saved()
        for newer in saved[:saved.index(path)]:
            newer.replace(newer.with_suffix('.damaged'))

    def _saved(self) -> list[Path]:
        """Return the checkpoints of iterations, newest first."""
        found = [p for p in self.checkpoints.iterdir() if _NAME.fullmatch(p.name)]
        return sorted(found, key=lambda p: int(p.stem.removeprefix('iteration_')), reverse=True)


def _without_non_finite(value: Any) -> Any:
    """Return a JSON value in which non-finite numbers are None, at any depth."""
    if isinstance(value, dict):
        return {name: _without_non_finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_non_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
