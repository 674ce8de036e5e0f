# SPDX-License-Identifier: Apache-2.0
"""Checks of the destinations of a recording, which need neither Rerun nor ROS.

The recorder makes them when it starts; the commands make them before they start anything.
"""
from __future__ import annotations

import errno
import ipaddress
import itertools
import os
import shutil
import socket
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias
from urllib.parse import urlsplit

from rocket_sim_node.recording.sinks.rerun_program import LOCAL

DEFAULT_PORT = 9876
"""Port of a viewer whose URL names none."""
LONGEST_ADDITION = len('.partial.repaired-999')
"""Characters that the name of a recording gains, at most, while it is written or repaired."""
RESERVE = 32 * 2**20
"""Bytes of disk space to keep free; below it a recording is closed, complete."""
Note: TypeAlias = Callable[[str, str], None]
"""Function that takes a level ('INFO', 'WARN', 'ERROR') and a text."""


def viewer_address(url: str) -> tuple[str, int]:
    """Return host and port of a viewer's URL.

    :raises ValueError: when it is not a valid URL.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:  # an impossible port or address
        parts, host, port = urlsplit(''), None, None
    if parts.scheme not in ('rerun', 'rerun+http', 'rerun+https') or not host \
            or parts.path != '/proxy':
        raise ValueError(
            f'connect: got {url!r}, expected a URL like rerun+http://127.0.0.1:9876/proxy')
    return host, port or DEFAULT_PORT


def page_address(host: str, name: str = 'web') -> ipaddress.IPv4Address:
    """Return the address at which a web page is to be served.

    :param name: what the parameter's name begins with.
    :raises ValueError: when `host` is not an IPv4 address.
    """
    try:
        return ipaddress.IPv4Address(host)
    except ValueError:
        raise ValueError(
            f'{name}_host: got {host!r}, expected an IPv4 address such as {LOCAL}') from None


def far_host(host: str) -> str:
    """Return the name or address by which other machines reach what is served at an address."""
    return socket.gethostname() if page_address(host).is_unspecified else host


def check_page(port: int, host: str, name: str = 'web') -> None:
    """Check that something can be served at a port of an address of this machine.

    :param name: what the parameters' names begin with.
    :raises ValueError: when it cannot, naming what is in the way.
    """
    address = str(page_address(host, name))
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
            probe.listen(1)
        except OSError as error:
            raise ValueError({
                errno.EADDRINUSE: f'{name}_port: {port} is taken by another program',
                errno.EADDRNOTAVAIL:
                    f'{name}_host: got {host!r}, expected an address of this machine',
            }.get(error.errno or 0, f'{name}_port: {port}: {error.strerror}')) from None


def check_suffix(recording: Path | str) -> None:
    """Check that a recording's name ends as one.

    :raises ValueError: when it does not.
    """
    if Path(recording).suffix != '.rrd':
        raise ValueError(
            f'output: got {str(recording)!r}, expected a name that ends with .rrd')


def check_name(name: str, folder: Path) -> None:
    """Check that the name of a recording is short enough for its temporary files.

    :param folder: one on the file system of the recording.
    :raises ValueError: when it is not.
    """
    longest = os.pathconf(folder, 'PC_NAME_MAX') - LONGEST_ADDITION
    if (length := len(os.fsencode(name))) > longest:
        raise ValueError(
            f'output: got a name of {length} bytes, {name[:20]}…, expected at most {longest}')


def numbered(path: Path, suffix: str = '') -> Iterator[Path]:
    """Yield PATH, PATH-2, PATH-3 …; numbers stand before the suffix."""
    yield path
    for number in itertools.count(2):
        yield path.with_name(f'{path.name.removesuffix(suffix)}-{number}{suffix}')


def is_at(file: int, path: Path) -> bool:
    """Return whether an open file or folder has this path."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def lock_error(error: OSError, taken: str, path: Path) -> OSError:
    """Return the error of a file or folder that could not be locked.

    :param taken: what it means that another process holds the lock.
    """
    reason = taken if isinstance(error, BlockingIOError) else f'cannot be locked: {error.strerror}'
    return OSError(error.errno, reason, str(path))


def check_space(folder: Path, needed: int = RESERVE) -> None:
    """Check that the disk of a folder has room.

    :raises OSError: when it does not.
    """
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise OSError(
            errno.ENOSPC,
            f'only {free / 2**20:.0f} MiB of disk left, {needed / 2**20:.0f} MiB needed',
            str(folder))
