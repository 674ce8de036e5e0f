# SPDX-License-Identifier: Apache-2.0
"""A run's log as TensorBoard events: `tensorboard --logdir runs` shows them."""
from __future__ import annotations

import time
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = 'tensorboard'
_EVENTS = 'events.out.tfevents.*'
_NO_CURVES = ('iteration', 'seconds')


class TensorBoardLogger:
    """Writes one scalar `STAGE/NAME` for each number of a line, by iteration."""

    def __init__(self, folder: Path) -> None:
        """Write into `tensorboard/` of the run's folder."""
        self._folder = folder / FOLDER
        self._writer: Any = None

    def begin(self, lines: Sequence[Mapping[str, Any]]) -> None:
        """Write these lines anew, so that no point is there twice after a resume.

        :raises OSError: when the folder cannot be written.
        """
        from torch.utils.tensorboard import SummaryWriter

        self._folder.mkdir(exist_ok=True)
        for old in self._folder.glob(_EVENTS):
            old.unlink()
        # The step to purge from makes a TensorBoard that is open forget the points it has read.
        self._writer = SummaryWriter(str(self._folder), purge_step=0)
        seconds = [float(line.get('seconds') or 0.0) for line in lines]
        when = time.time() - sum(seconds)
        for line, taken in zip(lines, seconds, strict=True):
            when += taken
            self._write(line, when)
        self._writer.flush()

    def entry(self, line: Mapping[str, Any]) -> None:
        """Write a line's numbers."""
        self._write(line, time.time())
        self._writer.flush()

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()

    def _write(self, line: Mapping[str, Any], when: float) -> None:
        for name, value in line.items():
            if isinstance(value, int | float) and name not in _NO_CURVES:
                self._writer.add_scalar(
                    f'{line["stage"]}/{name}', value, line['iteration'], walltime=when)
