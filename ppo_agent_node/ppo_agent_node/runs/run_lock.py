# SPDX-License-Identifier: Apache-2.0
"""Lock of a run's folder, which the system releases when its holder dies, and its marker."""
from __future__ import annotations

import fcntl
import os
from pathlib import Path

from rocket_sim_node import input_file

NAME = '.lock'
UNFINISHED = '.unfinished'
"""Marker file in the folder of a run that is in progress or can be resumed."""


def open_lock(folder: Path, flags: int = os.O_RDONLY) -> int:
    """Open the file that is locked; return its descriptor.

    :param flags: of `os.open`.
    :raises OSError: naming the file, when it is not a regular one, or cannot be opened.
    """
    return input_file.open_in_place(folder / NAME, flags)


def in_use(folder: Path) -> bool:
    """Return whether a process trains in a folder, of which there may be none."""
    try:
        with open(open_lock(folder), 'rb') as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
