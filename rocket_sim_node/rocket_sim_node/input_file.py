# SPDX-License-Identifier: Apache-2.0
"""Reading of input files: regular files of a sane size only, checked before they are read.

A device or a FIFO would be read for ever, and a file of many gigabytes would take all memory. A
file that is written in place, in a folder that may be another user's, is checked as well: a
FIFO would be waited for, and a link would lead to another file.
"""
from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: 'folder', stat.S_IFIFO: 'FIFO', stat.S_IFSOCK: 'socket',
    stat.S_IFCHR: 'device', stat.S_IFBLK: 'device', stat.S_IFLNK: 'symbolic link'}


def check(path: Path, largest: int) -> None:
    """Check a file that a library is going to read.

    :param largest: maximum size, bytes.
    :raises ValueError: naming the file, when it is not a regular one or larger.
    :raises OSError: when there is no such file.
    """
    _check(path, path.stat(), largest)


def read_bytes(path: Path, largest: int) -> bytes:
    """Return the content of a file.

    :param largest: maximum size, bytes.
    :raises ValueError: naming the file, when it is not a regular one or larger.
    :raises OSError: when it cannot be read.
    """
    check(path, largest)
    # O_NONBLOCK, as a FIFO may take the file's place in between; opening one would wait.
    with open(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK), 'rb') as file:
        status = os.fstat(file.fileno())
        _check(path, status, largest)
        return file.read(status.st_size)  # no more, should it grow meanwhile


def read_text(path: Path, largest: int) -> str:
    """Return the content of a text file in UTF-8, whose lines end as anywhere.

    :param largest: maximum size, bytes.
    :raises ValueError: naming the file, when it is not a regular one, larger, or not UTF-8.
    :raises OSError: when it cannot be read.
    """
    try:
        text = read_bytes(path, largest).decode()
    except UnicodeDecodeError as error:
        raise ValueError(f'{path}: damaged: {error}') from error
    return text.replace('\r\n', '\n').replace('\r', '\n')


def open_in_place(path: Path, flags: int) -> int:
    """Open a file that is kept open, or written in place; return its descriptor.

    :param flags: of `os.open`.
    :raises OSError: naming the file, when it is not a regular one, or cannot be opened.
    """
    try:
        descriptor = os.open(
            path, flags | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):  # a link; a FIFO or socket
            _require_regular(path, path.lstat())
        raise
    try:
        _require_regular(path, os.fstat(descriptor))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _require_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, _refusal(status), str(path))


def _refusal(status: os.stat_result) -> str:
    kind = _KINDS.get(stat.S_IFMT(status.st_mode), 'special file')
    return f'got a {kind}, expected a regular file'


def _check(path: Path, status: os.stat_result, largest: int) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise ValueError(f'{path}: {_refusal(status)}')
    if status.st_size > largest:
        raise ValueError(f'{path}: got {status.st_size} bytes, expected at most {largest}')
