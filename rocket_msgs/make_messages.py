# SPDX-License-Identifier: Apache-2.0
"""Writes the fields of RocketState.msg and TrainingStatus.msg from the tables of telemetry.

Run it in a shell of the environment, and then launch_scripts/setup. The text before these fields
is written by hand.
"""
from __future__ import annotations

import textwrap
from dataclasses import fields
from pathlib import Path

import numpy as np

from rocket_sim_node.telemetry.quantities import QUANTITIES
from rocket_sim_node.telemetry.training_status import Status

FOLDER = Path(__file__).parent / 'msg'
_COLUMN, _WIDTH = 28, 99


def _line(declaration: str, comment: str) -> str:
    """Return a field with its comment, which is wrapped below its beginning."""
    return textwrap.fill(
        comment, _WIDTH, initial_indent=f'{declaration:<{_COLUMN - 2}}  # ',
        subsequent_indent=' ' * _COLUMN + '# ', break_on_hyphens=False) or declaration


def texts() -> dict[Path, str]:
    """Return the text of each file."""
    state = [_line('uint64[] step', 'S')] + [
        _line(f'{np.dtype(one.kind).name}[] {one.name}',
              f'S{"" if one.width == 1 else f" x {one.width}"}, {one.meaning}')
        for one in QUANTITIES]
    status = [
        _line(f'{one.metadata["kind"]} {one.name}', one.metadata['meaning'])
        for one in fields(Status)]
    found = {}
    for name, lines in (('RocketState.msg', state), ('TrainingStatus.msg', status)):
        path = FOLDER / name
        head, _, _ = path.read_text().partition(lines[0].partition('#')[0].rstrip())
        found[path] = head + '\n'.join(lines) + '\n'
    return found


if __name__ == '__main__':
    for path, text in texts().items():
        path.write_text(text)
