# SPDX-License-Identifier: Apache-2.0
"""A system clock that a test can set for its processes; see stepped_clock.c."""
from __future__ import annotations

import struct
import subprocess
from pathlib import Path

_SOURCE = Path(__file__).with_suffix('.c')


class SteppedClock:
    """The system clock of processes that are started with `command`."""

    def __init__(self, folder: Path) -> None:
        """Compile the library into a folder; the clock begins at the time of the machine."""
        self._library, self._offset = folder / 'stepped_clock.so', folder / 'offset'
        subprocess.run(
            ['cc', '-O2', '-shared', '-fPIC', '-o', self._library, _SOURCE, '-ldl'], check=True)
        self.set(0.0)

    def set(self, offset: float) -> None:
        """Set the clock to the time of the machine plus `offset` s."""
        # Not with Path.write_bytes, which truncates the file, because processes have mapped it.
        with self._offset.open('r+b' if self._offset.exists() else 'wb') as file:
            file.write(struct.pack('=d', offset))

    def command(self, *command: str) -> list[str]:
        """Return the given command, prefixed so that it runs with this clock."""
        return ['env', f'LD_PRELOAD={self._library}', f'STEPPED_CLOCK={self._offset}', *command]
