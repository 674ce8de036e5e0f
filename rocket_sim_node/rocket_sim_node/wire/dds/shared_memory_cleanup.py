# SPDX-License-Identifier: Apache-2.0
"""Removal of Fast DDS's leftover shared memory of dead processes, when a node starts.

A participant owns a segment for its messages and ports for notifications from others, as files in
/dev/shm. Beside each lies a lock file that its owner keeps locked (flock) while it lives. When a
process is killed, only its locks disappear: 2 MB of files remain. Live peers or `fastdds shm
clean` remove some of them, but nothing removes ports that were only written to, or the semaphores
that guard the opening of ports.
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

from rocket_sim_node.wire.dds.semaphore import UNFINISHED
from rocket_sim_node.wire.dds.semaphore import taken

SHARED_MEMORY = Path('/dev/shm')
PROFILE = 'hoverslam_'
"""Name prefix of temporary profiles that Fast DDS reads while a node starts."""
_START = 60.0
"""Upper limit of a node's start-up time, s."""
_NAME = re.compile(r'(?:sem\.)?(fast(?:dds|rtps)_(?:[0-9a-f]{16}|port\d+))(_el|_sl|_mutex)?')
_PORT = re.compile(r'fast(?:dds|rtps)_port(\d+)')
_LOCKS = ('_el', '_sl')
OWN_PORTS = 32768
"""First data port of nodes here; each start draws its own, see transport.py. Few domains have
ports there. Below it, participants take any free port."""
_YOUNG = 2.0
"""Minimum age, s; a starting process may not have locked or mapped its files yet."""
_BATCH = 64
"""Ports without locks checked at once, as finding the processes that map them is slow."""
_MOST_HELD = 1.0
"""Longest time, s, to hold a port's semaphore; Fast DDS waits twice as long, then ignores it."""


def clean(folder: Path = SHARED_MEMORY, young: float = _YOUNG) -> list[str]:
    """Remove this user's files that belong to no live process, and return their names.

    A segment or port and its files are kept while it is young or its lock is held. One without a
    lock is kept while a process that this user may inspect maps one of its files. Files that
    cannot be removed are kept too. A peer's mapping of a dead process's port does not protect it:
    Fast DDS recreates such a port, and its own `shm clean` removes it as well.

    Other participants that start meanwhile, including those of other programs, try ports of the
    same names and open each under its semaphore. The removal takes the same semaphore; otherwise
    it might delete a port that a process has just reused, which would then receive no
    notifications. The semaphores of such ports are kept.

    :param young: age, s, below which nothing is removed.
    """
    removed: list[str] = []
    with suppress(OSError):  # e.g. too many open files; the next start tries again
        removed += _remove([
            file for pattern in (f'{PROFILE}*.xml', f'{UNFINISHED}*')
            for file in folder.glob(pattern) if _is_old([file], _START)])
        unlocked = []
        for name in _names(folder):
            files = _files(folder, name)
            if not _is_old(files, young):
                continue
            if not any(map(_is_lock, files)):
                unlocked.append(name)
                continue
            with ExitStack() as stack:
                removed += _remove(_hold(folder, name, young, stack))
        for begin in range(0, len(unlocked), _BATCH):
            removed += _clean_unlocked(folder, unlocked[begin:begin + _BATCH], young)
    return removed


def _clean_unlocked(folder: Path, names: list[str], young: float) -> list[str]:
    """Remove unmapped segments and ports that have no lock file, and stuck semaphores."""
    with ExitStack() as stack:
        begin = time.monotonic()
        held = [_hold(folder, name, young, stack) for name in names]
        used = _mapped(folder) if any(held) else set()
        if time.monotonic() - begin > _MOST_HELD:
            return []
        # The semaphores are mapped by this process; waiting for one does not map its port.
        return [
            name for files in held
            if not used & {file.name for file in files if not file.name.startswith('sem.')}
            for name in _remove(files)]


def _hold(folder: Path, name: str, young: float, stack: ExitStack) -> list[Path]:
    """Lock a segment or port, so that no process can open it until the stack is closed.

    Returns the files to remove; none if a process owns it. If a process died while holding the
    port's semaphore, it blocks all others: then only the semaphore is to be removed.
    """
    files = _files(folder, name)
    if not files:
        return []
    semaphore = folder / f'sem.{name}_mutex'
    with ExitStack() as attempt:
        if _PORT.fullmatch(name):
            try:
                if not attempt.enter_context(taken(semaphore)):
                    return [semaphore] if _is_stuck(semaphore, young) else []
            except OSError:
                return []
            files = _files(folder, name)
        rest = [file for file in files if file != semaphore]
        # The semaphore's age was checked above; some file systems update it when it is acquired.
        if not _is_old(rest, young) or not _lock(rest, attempt):
            return []
        stack.push(attempt.pop_all())
        return rest if _is_shared(name) else files


def _is_stuck(semaphore: Path, young: float) -> bool:
    """Return whether a semaphore stays taken although no process holds it."""
    for _ in range(2):
        if not _is_old([semaphore], young) or semaphore.name in _mapped(semaphore.parent):
            return False
        with taken(semaphore) as mine:
            if mine:
                return False
    return True


def _names(folder: Path) -> list[str]:
    """Return the names of the segments and ports of Fast DDS in a folder."""
    return list(dict.fromkeys(
        match[1] for file in folder.iterdir() if (match := _NAME.fullmatch(file.name))))


def _files(folder: Path, name: str) -> list[Path]:
    """Return the existing files of a segment or port."""
    names = (name, *(name + suffix for suffix in _LOCKS), f'sem.{name}_mutex')
    return [folder / each for each in names if os.path.lexists(folder / each)]


def _is_lock(file: Path) -> bool:
    return file.name.endswith(_LOCKS)


def _is_shared(name: str) -> bool:
    """Return whether this is a port that several processes use, one after the other.

    Its semaphore is kept: removed while a process waits for it, it would no longer protect the
    port.
    """
    match = _PORT.fullmatch(name)
    return match is not None and int(match[1]) < OWN_PORTS


def _is_old(files: list[Path], young: float) -> bool:
    """Return whether all files are regular, owned by this user and old enough."""
    try:
        found = [file.lstat() for file in files]
    except OSError:  # removed meanwhile: in use
        return False
    now, user = time.time(), os.geteuid()
    return all(
        stat.S_ISREG(status.st_mode) and status.st_uid == user
        and abs(now - status.st_mtime) >= young  # absolute, as the clock may have been set back
        for status in found)


def _lock(files: list[Path], stack: ExitStack) -> bool:
    """Lock the lock files among these until the stack is closed; return whether that succeeded."""
    try:
        for file in filter(_is_lock, files):
            descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.path.samestat(os.fstat(descriptor), file.lstat()):
                return False  # removed and recreated by other processes meanwhile
    except OSError:
        return False
    return True


def _remove(files: list[Path]) -> list[str]:
    """Remove files, lock files last, and return the names of those removed."""
    removed = []
    for file in sorted(files, key=_is_lock):
        with suppress(OSError):
            file.unlink()
            removed.append(file.name)
    return removed


def _mapped(folder: Path) -> set[str]:
    """Return the names of a folder's files that are mapped by any process."""
    prefix = f'{folder}/'
    return {path.removeprefix(prefix) for path in _mappings() if path.startswith(prefix)}


def _mappings() -> Iterator[str]:
    for process in Path('/proc').iterdir():
        if process.name.isdecimal():
            with suppress(OSError), (process / 'maps').open(errors='replace') as lines:
                for line in lines:
                    # columns: address, permissions, offset, device, inode, path
                    fields = line.split(maxsplit=5)
                    if len(fields) == 6:
                        yield fields[5].rstrip('\n')
