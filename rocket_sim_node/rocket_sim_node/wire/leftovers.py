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
_BATCH = 64
"""ports without locks that are looked at together, as each look takes all processes"""


def clean(folder: Path = SHARED_MEMORY, young: float = _YOUNG) -> list[str]:
    """Remove this user's files that belong to nobody alive, and return their names.

    A segment or port stays, with all that belongs to it, while it is young or its lock is held;
    where there is no lock, while a process that this user may look at has one of its files mapped.
    What cannot be removed stays too. That a peer has the port of a dead process mapped keeps
    nothing: Fast DDS makes such a port anew, and its own `shm clean` removes it as well.

    Participants of other programs that start meanwhile take ports by the same names, 7000 and up.
    Whoever of them finds a lock held takes the next port; so all locks of a port are held, those
    that are missing as well, from before the last look until its last file is gone.

    :param young: age, s, below which nothing is removed.
    """
    old = [files for files in _groups(folder) if _is_old(files, young)]
    unlocked = [files for files in old if not any(map(_is_lock, files))]
    removed = []
    for files in old:
        if files not in unlocked:
            with ExitStack() as stack:
                if _lock(files, stack):
                    removed += _remove(files)
    used = _mapped(folder) if unlocked else set()
    unlocked = [files for files in unlocked if not _is_used(files, used)]
    for batch in (unlocked[begin:begin + _BATCH] for begin in range(0, len(unlocked), _BATCH)):
        with ExitStack() as stack:
            claimed = [files for files in batch if _make_locks(files, stack)]
            used = _mapped(folder) if claimed else set()
            for files in claimed:
                if not _is_used(files, used):
                    removed += _remove(files)
    profiles = [file for file in folder.glob(f'{PROFILE}*.xml') if _is_old([file], _START)]
    return removed + _remove(profiles)


def _is_lock(file: Path) -> bool:
    return file.name.endswith(_LOCKS)


def _is_used(files: list[Path], names: set[str]) -> bool:
    return any(file.name in names for file in files)


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


def _lock(files: list[Path], stack: ExitStack) -> bool:
    """Lock those that are for it until the stack is closed; tell whether that could be done."""
    try:
        for file in filter(_is_lock, files):
            descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.path.samestat(os.fstat(descriptor), file.lstat()):
                return False  # removed by somebody, and made anew by somebody else
    except OSError:
        return False
    return True


def _make_locks(files: list[Path], stack: ExitStack) -> bool:
    """Make the locks of a port that has none, and hold them until the stack is closed.

    They are gone afterwards. Tell whether that could be done.
    """
    match = _NAME.fullmatch(files[0].name)
    assert match is not None
    locks = [files[0].with_name(match[1] + suffix) for suffix in _LOCKS]
    try:
        for lock in locks:
            os.close(os.open(lock, os.O_RDONLY | os.O_CLOEXEC | os.O_CREAT | os.O_EXCL, 0o600))
            if not _lock([lock], stack):
                return False
            stack.callback(_remove, [lock])
    except OSError:  # such as: somebody has made it first, and has the port
        return False
    return True


def _remove(files: list[Path]) -> list[str]:
    """Remove files, locks at last, and return the names of those removed."""
    removed = []
    for file in sorted(files, key=_is_lock):
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
