# SPDX-License-Identifier: Apache-2.0
"""What Fast DDS left in shared memory for processes that are dead, removed when a node starts.

A participant has a segment for its messages and ports at which it is told of those of others,
files in /dev/shm; beside each lies one that its owner keeps locked (flock) while it lives. Who is
killed takes nothing along but its locks: 2 MB stay. Some of it is removed by peers that live or
by `fastdds shm clean`; ports that were only written to, and the semaphores by which ports are
opened, by nobody.
"""
from __future__ import annotations

import fcntl
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path('/dev/shm')
PROFILE = 'hoverslam_'
"""with which names of files begin that Fast DDS reads while a node starts"""
_START = 60.0
"""s; longer than that takes"""
_NAME = re.compile(r'(?:sem\.)?(fast(?:dds|rtps)_(?:[0-9a-f]{16}|port\d+))(_el|_sl|_mutex)?')
_LOCKS = ('_el', '_sl')
_YOUNG = 2.0
"""s; a process that is just starting may not have locked or mapped yet what it made"""


def clean(folder: Path = SHARED_MEMORY, young: float = _YOUNG) -> list[str]:
    """Remove this user's files that belong to nobody alive, and return their names.

    A segment or port stays, with all that belongs to it, while it is young or its lock is held;
    where there is no lock, while a process that this user may look at has one of its files mapped.
    What cannot be removed stays too. That a peer has the port of a dead process mapped keeps
    nothing: Fast DDS makes such a port anew, and its own `shm clean` removes it as well.

    :param young: age, s, below which nothing is removed.
    """
    old = [files for files in _groups(folder) if _is_old(files, young) and _is_free(files)]
    old += [[file] for file in folder.glob(f'{PROFILE}*.xml') if _is_old([file], _START)]
    unlocked = [files for files in old if not any(map(_is_lock, files))]
    used = _mapped(folder) if unlocked else set()
    return [
        name for files in old
        if files not in unlocked or not used & {file.name for file in files}
        for name in _remove(files)]


def _is_lock(file: Path) -> bool:
    return file.name.endswith(_LOCKS)


def _groups(folder: Path) -> list[list[Path]]:
    """Return the files of Fast DDS in a folder, those of each segment and each port together."""
    groups: dict[str, list[Path]] = {}
    with suppress(OSError):
        for file in folder.iterdir():
            if match := _NAME.fullmatch(file.name):
                groups.setdefault(match[1], []).append(file)
    return list(groups.values())


def _is_old(files: list[Path], young: float) -> bool:
    """Tell whether all are files, this user's, and old enough."""
    try:
        found = [file.lstat() for file in files]
    except OSError:  # gone meanwhile: somebody is at it
        return False
    now, user = time.time(), os.geteuid()
    return all(
        stat.S_ISREG(status.st_mode) and status.st_uid == user
        and abs(now - status.st_mtime) >= young  # the clock may have been set back since
        for status in found)


def _is_free(files: list[Path]) -> bool:
    """Tell whether none of the files is locked."""
    with ExitStack() as stack:
        return _lock(files, stack)


def _lock(files: list[Path], stack: ExitStack) -> bool:
    """Lock those that are for it; tell whether that could be done."""
    try:
        for file in files:
            if _is_lock(file):
                descriptor = os.open(
                    file, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
                stack.callback(os.close, descriptor)
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _remove(files: list[Path]) -> list[str]:
    """Remove files that are still free, and return the names of those removed."""
    removed = []
    with ExitStack() as stack:
        if _lock(files, stack):
            for file in files:
                with suppress(OSError):
                    file.unlink()
                    removed.append(file.name)
    return removed


def _mapped(folder: Path) -> set[str]:
    """Return the names of the files of a folder that processes have mapped."""
    prefix = f'{folder}/'
    return {path.removeprefix(prefix) for path in _mappings() if path.startswith(prefix)}


def _mappings() -> Iterator[str]:
    for process in Path('/proc').iterdir():
        if process.name.isdecimal():
            with suppress(OSError), (process / 'maps').open(errors='replace') as lines:
                for line in lines:
                    # address, rights, offset, device, inode, path
                    fields = line.split(maxsplit=5)
                    if len(fields) == 6:
                        yield fields[5].rstrip('\n')
