# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files: complete or not at all."""
from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

_SCRATCH = re.compile(r'\..+\.(\d+)\.part')
"""Name of a temporary file, with the id of the writing process."""


def write_atomically(path: Path, data: bytes) -> None:
    """Write `data` to a file atomically, and sync it to disk.

    :raises OSError: naming the path; the file has its old content, or all of `data`.
    """
    scratch = path.with_name(f'.{path.name}.{os.getpid()}.part')
    try:
        with scratch.open('wb') as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise OSError(error.errno, f'could not write: {error.strerror}', str(path)) from error
    except BaseException:
        # E.g. a signal that abandons the work, see rocket_sim_node.wire.node.stopping.
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files that processes left in a folder when they died.

    :raises OSError: naming the path.
    """
    for path in folder.iterdir():
        writer = _SCRATCH.fullmatch(path.name)
        if writer and not Path('/proc', writer[1]).exists():
            path.unlink(missing_ok=True)
