# SPDX-License-Identifier: Apache-2.0
"""Reader of a run's log, `train.jsonl`, without PyTorch, so that a report starts quickly."""
from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rocket_sim_node import input_file

LARGEST = 2**30
"""Maximum bytes; an iteration takes one or two thousand."""


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a `train.jsonl`, without a truncated last one.

    :raises ValueError: naming the file, and the line when another one is damaged.
    """
    text = input_file.read_text(path, LARGEST) if path.exists() else ''
    lines = []
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        if not line.endswith('\n'):
            break
        try:
            found = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ValueError(f'{path}: line {number} is damaged: {error}') from error
        if not isinstance(found, dict):
            raise ValueError(f'{path}: line {number} is damaged: expected an object')
        lines.append(found)
    return lines
