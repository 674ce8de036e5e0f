# SPDX-License-Identifier: Apache-2.0
"""A named POSIX semaphore as a lock between processes, acquired without blocking."""
from __future__ import annotations

import ctypes
import mmap
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path

UNFINISHED = 'hoverslam_semaphore_'
"""Name prefix of a semaphore under construction."""
_SIZE = 32
"""Size, bytes, of a `sem_t` in glibc, which is the content of a named semaphore's file."""
_LIBRARY = ctypes.CDLL(None)


@contextmanager
def taken(file: Path) -> Iterator[bool]:
    """Try to acquire a semaphore without waiting; release it on exit.

    Yields whether it was acquired; false when a process holds it, or died holding it.

    :param file: of a named semaphore, such as `/dev/shm/sem.name`; created if missing.
    :raises OSError: when it cannot be opened or created, is not a semaphore, belongs to another
        user, or was removed while being acquired.
    """
    memory, status = _opened(file)
    semaphore = (ctypes.c_char * _SIZE).from_buffer(memory)
    took = _LIBRARY.sem_trywait(ctypes.byref(semaphore)) == 0
    try:
        if took:
            if not os.path.samestat(status, file.lstat()):
                raise OSError(f'{file}: was replaced meanwhile')
            yield True
    finally:
        if took:
            _LIBRARY.sem_post(ctypes.byref(semaphore))
        del semaphore  # the reference would keep the mapping from being closed
        memory.close()
    if not took:
        yield False  # unmapped first: a search for processes that map it must not find this one


def _opened(file: Path) -> tuple[mmap.mmap, os.stat_result]:
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        descriptor = os.open(file, flags)
    except FileNotFoundError:
        _make(file)
        descriptor = os.open(file, flags)
    try:
        status = os.fstat(descriptor)
        if not (stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
                and status.st_size >= _SIZE):
            raise OSError(f"{file}: expected this user's semaphore of {_SIZE} bytes")
        return mmap.mmap(descriptor, _SIZE), status
    finally:
        os.close(descriptor)


def _make(file: Path) -> None:
    """Create a free semaphore atomically, as glibc does."""
    content = bytearray(_SIZE)
    if _LIBRARY.sem_init(ctypes.byref((ctypes.c_char * _SIZE).from_buffer(content)), 1, 1):
        raise OSError(f'{file}: the semaphore could not be created')
    with tempfile.NamedTemporaryFile(prefix=UNFINISHED, dir=file.parent) as unfinished:
        unfinished.write(content)
        unfinished.flush()
        os.fchmod(unfinished.fileno(), 0o644)
        with suppress(FileExistsError):
            os.link(unfinished.name, file)
