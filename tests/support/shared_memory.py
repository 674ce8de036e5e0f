# SPDX-License-Identifier: Apache-2.0
"""Which files of Fast DDS in shared memory belong to a process, and what is left of them."""
from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from support.processes import Process

FOLDER = Path('/dev/shm')


def processes_of(process: Process) -> list[Path]:
    """Return /proc of the processes that were started as one: `ros2 run` may start another."""
    found = []
    for folder in all_processes():
        with suppress(ProcessLookupError):
            if os.getpgid(int(folder.name)) == process.pid:
                found.append(folder)
    return found


def all_processes() -> list[Path]:
    """Return /proc of all processes of this machine."""
    return [folder for folder in Path('/proc').iterdir() if folder.name.isdecimal()]


def locked(processes: Iterable[Path]) -> set[str]:
    """Return the segments and ports whose lock files processes have open."""
    found = set()
    for folder in processes:
        with suppress(OSError):
            for link in (folder / 'fd').iterdir():
                with suppress(OSError):
                    path = Path(os.readlink(link))
                    if path.parent == FOLDER and path.name.endswith(('_el', '_sl')):
                        found.add(path.name[:-3])
    return found


def mapped(processes: Iterable[Path]) -> set[str]:
    """Return the files that processes have mapped."""
    found = set()
    for folder in processes:
        with suppress(OSError):
            for line in (folder / 'maps').read_text(errors='replace').splitlines():
                if f' {FOLDER}/' in line:
                    found.add(line.rsplit('/', 1)[1])
    return found


def owned(process: Process) -> set[str]:
    """Return the segments and ports that a process has locked, and mapped as well.

    For a moment each process has others' lock files open, to see whether their owners live.
    """
    these = processes_of(process)
    return locked(these) & mapped(these)


def files(names: set[str]) -> set[str]:
    """Return the files there are of segments and ports."""
    found = {
        file for name in names for file in (name, f'{name}_el', f'{name}_sl', f'sem.{name}_mutex')}
    return {file for file in found if (FOLDER / file).exists()}


def left(names: set[str]) -> set[str]:
    """Return the files of segments and ports that no process uses.

    The ports from 7000 on are those of all nodes of a machine, whatever their domain.
    """
    there = all_processes()
    return files(names - locked(there) - mapped(there))
