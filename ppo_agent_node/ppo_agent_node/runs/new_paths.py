# SPDX-License-Identifier: Apache-2.0
"""Files and folders named after the time, each taken once.

Two may be made within one second, and a clock may be set back. As a command it makes a folder and
prints its name.
"""
from __future__ import annotations

import os
import sys
from pathlib import Path

from rocket_sim_node.recording.sinks.destinations import numbered

PARTIAL = '.partial.rrd'
"""ends the name under which the recorder writes a recording"""


def new_folder(path: Path) -> Path:
    """Make a folder, numbered where there is one of its name, and return its path.

    :raises OSError: when it cannot be made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for folder in numbered(path):
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError


def new_recording(path: Path) -> Path:
    """Reserve the name of a recording, numbered where it is taken, and return its path.

    An empty file with the name under which the recorder writes holds it.

    :param path: ends in `.rrd`.
    :raises OSError: when that file cannot be made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for recording in numbered(path, path.suffix):
        partial = recording.with_name(recording.stem + PARTIAL)
        try:
            os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except FileExistsError:
            continue
        if not recording.exists():
            return recording
        partial.unlink()
    raise AssertionError


if __name__ == '__main__':
    try:
        sys.stdout.write(f'{new_folder(Path(sys.argv[1]))}\n')
    except OSError as error:
        sys.exit(str(error))
