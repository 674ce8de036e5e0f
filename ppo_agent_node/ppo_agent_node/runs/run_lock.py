# SPDX-License-Identifier: Apache-2.0
"""Lock of a run's folder, which the system releases when its holder dies."""
from __future__ import annotations

import fcntl
from pathlib import Path

NAME = '.lock'


def in_use(folder: Path) -> bool:
    """Return whether a process trains in a folder, of which there may be none."""
    try:
        with (folder / NAME).open('rb') as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
