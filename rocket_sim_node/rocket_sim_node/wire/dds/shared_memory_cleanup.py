# SPDX-License-Identifier: Apache-2.0
"""What Fast DDS left in shared memory for processes that are dead, removed when a node starts.

A participant has a segment for its messages and ports at which it is told of those of others,
files in /dev/shm; beside each lies one that its owner keeps locked (flock) while it lives. Who is
killed takes nothing along but its locks: 2 MB stay. Some of it is removed by peers that live or
by `fastdds shm clean`; ports that were only written to, and the semaphores under which ports are
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

from rocket_sim_node.wire.dds.semaphore import UNFINISHED
from rocket_sim_node.wire.dds.semaphore import taken

SHARED_MEMORY = Path('/dev/shm')
PROFILE = 'hoverslam_'
"""with which names of files begin that Fast DDS reads while a node starts"""
_START = 60.0
"""s; longer than that takes"""
_NAME = re.compile(r'(?:sem\.)?(fast(?:dds|rtps)_(?:[0-9a-f]{16}|port\d+))(_el|_sl|_mutex)?')
_PORT = re.compile(r'fast(?:dds|rtps)_port(\d+)')
_LOCKS = ('_el', '_sl')
OWN_PORTS = 32768
"""from where nodes here draw their ports, each start others, see transport.py: few domains have
theirs there. Below, participants take what is free"""
_YOUNG = 2.0
"""s; a process that is just starting may not have locked or mapped yet what it made"""
_BATCH = 64
"""ports without locks that are held together, as a look at who has them mapped takes its time"""
_MOST_HELD = 1.0
"""s; who wants to open a port waits for twice as long, and goes on without the semaphore"""


def clean(folder: Path = SHARED_MEMORY, young: float = _YOUNG) -> list[str]:
    """Remove this user's files that belong to nobody alive, and return their names.

    A segment or port stays, with all that belongs to it, while it is young or its lock is held;
    where there is no lock, while a process that this user may look at has one of its files mapped.
    What cannot be removed stays too. That a peer has the port of a dead process mapped keeps
    nothing: Fast DDS makes such a port anew, and its own `shm clean` removes it as well.

    Participants that start meanwhile, those of other programs, too, try ports of the same names,
    and open each under its semaphore. So does who removes one here: otherwise it might remove what
    somebody has just taken over, who would hear of nobody any more. The semaphores of such ports
    stay.

    :param young: age, s, below which nothing is removed.
    """
    removed: list[str] = []
    with suppress(OSError):  # such as: too many files are open. The next start may do better.
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
    """Remove segments and ports without locks that no process has mapped, and stuck semaphores."""
    with ExitStack() as stack:
        begin = time.monotonic()
        held = [_hold(folder, name, young, stack) for name in names]
        used = _mapped(folder) if any(held) else set()
        if time.monotonic() - begin > _MOST_HELD:
            return []
        # The semaphores are mapped here; who waits for one has no more of its port.
        return [
            name for files in held
            if not used & {file.name for file in files if not file.name.startswith('sem.')}
            for name in _remove(files)]


def _hold(folder: Path, name: str, young: float, stack: ExitStack) -> list[Path]:
    """Lock a segment or port, and have nobody open it until the stack is closed.

    Returns which files are to be removed; none if it belongs to somebody. Whoever died with the
    semaphore of a port in hand keeps all others waiting: that alone is to be removed then.
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
        # The semaphore was old as well; some file systems note that it was taken.
        if not _is_old(rest, young) or not _lock(rest, attempt):
            return []
        stack.push(attempt.pop_all())
        return rest if _is_shared(name) else files


def _is_stuck(semaphore: Path, young: float) -> bool:
    """Tell whether a semaphore stays taken although no process has it."""
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
    """Return the files of a segment or port that there are."""
    names = (name, *(name + suffix for suffix in _LOCKS), f'sem.{name}_mutex')
    return [folder / each for each in names if os.path.lexists(folder / each)]


def _is_lock(file: Path) -> bool:
    return file.name.endswith(_LOCKS)


def _is_shared(name: str) -> bool:
    """Tell whether something is a port that many take, one after the other.

    Its semaphore stays: removed while somebody waits for it, it would protect nothing.
    """
    match = _PORT.fullmatch(name)
    return match is not None and int(match[1]) < OWN_PORTS


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
