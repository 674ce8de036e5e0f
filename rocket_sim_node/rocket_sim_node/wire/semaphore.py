# SPDX-License-Identifier: Apache-2.0
"""A POSIX semaphore by which processes take turns, taken without waiting."""
from __future__ import annotations

import ctypes
import mmap
import os
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
    :raises OSError: when it cannot be opened or made, or is none.
    """
    memory = _opened(file)
    semaphore = (ctypes.c_char * _SIZE).from_buffer(memory)
    took = _LIBRARY.sem_trywait(ctypes.byref(semaphore)) == 0
    try:
        if took:
            yield True
    finally:
        if took:
            _LIBRARY.sem_post(ctypes.byref(semaphore))
        del semaphore  # which keeps the memory from being closed
        memory.close()
    if not took:
        yield False  # who looks who has it mapped shall not find this process


def _opened(file: Path) -> mmap.mmap:
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        descriptor = os.open(file, flags)
    except FileNotFoundError:
        _make(file)
        descriptor = os.open(file, flags)
    try:
        return mmap.mmap(descriptor, _SIZE)
    except ValueError as error:
        raise OSError(f'{file}: expected a semaphore of {_SIZE} bytes: {error}') from error
    finally:
        os.close(descriptor)


def _make(file: Path) -> None:
    """Make a semaphore that nobody has, as glibc does: whole, or not at all."""
    content = bytearray(_SIZE)
    _LIBRARY.sem_init(ctypes.byref((ctypes.c_char * _SIZE).from_buffer(content)), 1, 1)
    with tempfile.NamedTemporaryFile(prefix=UNFINISHED, dir=file.parent) as unfinished:
        unfinished.write(content)
        unfinished.flush()
        os.fchmod(unfinished.fileno(), 0o644)
        with suppress(FileExistsError):
            os.link(unfinished.name, file)
