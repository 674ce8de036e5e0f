# SPDX-License-Identifier: Apache-2.0
"""Temporary folders that the next start removes when their process was killed.

`launch_scripts/command.sh` makes the same kind of folder: one with a file `lock` that its process
keeps locked. The kernel releases the lock however that process ends.
"""
from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path

_PREFIX, _LOCK = 'hoverslam-', 'lock'
_YOUNG = 60.0
"""Age in s up to which a folder stays in any case: its process may be about to lock it."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a temporary folder; remove it at the end, and those of killed processes before."""
    remove_leftovers(Path(tempfile.gettempdir()))
    with (tempfile.TemporaryDirectory(prefix=_PREFIX) as name,
          open(Path(name) / _LOCK, 'w', encoding='utf-8') as lock):
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield Path(name)


def remove_leftovers(parent: Path) -> None:
    """Remove this user's scratch folders that no process has locked."""
    for folder in parent.glob(f'{_PREFIX}*'):
        with suppress(OSError):
            about = folder.lstat()
            if about.st_uid != os.getuid():
                continue
            if abs(time.time() - about.st_mtime) < _YOUNG:  # the clock may have been set back
                continue
            if folder.is_symlink():
                continue
            with open(folder / _LOCK, encoding='utf-8') as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
