# SPDX-License-Identifier: Apache-2.0
"""Files that are there as a whole or not at all."""
from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

_SCRATCH = re.compile(r'\..+\.(\d+)\.part')
"""name of what is being written, with the id of the process that does"""


def write_atomically(path: Path, data: bytes) -> None:
    """Put `data` into a file, all of it or none, and see it onto the disk.

    :raises OSError: naming the path; there is what was before, or all of `data`.
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
        # A signal that abandons the work, see rocket_sim_node.wire.node.stopping.
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise


def remove_leftovers(folder: Path) -> None:
    """Remove what processes that died while they wrote left in a folder.

    :raises OSError: naming the path.
    """
    for path in folder.iterdir():
        writer = _SCRATCH.fullmatch(path.name)
        if writer and not Path('/proc', writer[1]).exists():
            path.unlink(missing_ok=True)
