# SPDX-License-Identifier: Apache-2.0
"""A POSIX semaphore by which processes take turns, taken without waiting."""
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
"""with which the name of one begins that is being made"""
_SIZE = 32
"""bytes of a `sem_t` in glibc, which is what the file of a named semaphore holds"""
_LIBRARY = ctypes.CDLL(None)


@contextmanager
def taken(file: Path) -> Iterator[bool]:
    """Take a semaphore, if that can be done at once, and give it back in the end.

    Yields whether it was taken; false where somebody has it, or died with it.

    :param file: of a named semaphore, such as `/dev/shm/sem.name`; made where there is none.
    :raises OSError: when it cannot be opened or made, is none or another user's, or was removed
        as it was taken.
    """
    memory, status = _opened(file)
    semaphore = (ctypes.c_char * _SIZE).from_buffer(memory)
    took = _LIBRARY.sem_trywait(ctypes.byref(semaphore)) == 0
    try:
        if took:
            if not os.path.samestat(status, file.lstat()):
                raise OSError(f'{file}: is another one now')
            yield True
    finally:
        if took:
            _LIBRARY.sem_post(ctypes.byref(semaphore))
        del semaphore  # which keeps the memory from being closed
        memory.close()
    if not took:
        yield False  # who looks who has it mapped shall not find this process


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
    """Make a semaphore that nobody has, as glibc does: whole, or not at all."""
    content = bytearray(_SIZE)
    if _LIBRARY.sem_init(ctypes.byref((ctypes.c_char * _SIZE).from_buffer(content)), 1, 1):
        raise OSError(f'{file}: a semaphore could not be made')
    with tempfile.NamedTemporaryFile(prefix=UNFINISHED, dir=file.parent) as unfinished:
        unfinished.write(content)
        unfinished.flush()
        os.fchmod(unfinished.fileno(), 0o644)
        with suppress(FileExistsError):
            os.link(unfinished.name, file)
