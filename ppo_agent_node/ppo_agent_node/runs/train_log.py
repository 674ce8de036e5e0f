# SPDX-License-Identifier: Apache-2.0
"""The log of a run, `train.jsonl`, as it is read: without PyTorch, so that a report is quick."""
from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def read_log(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a `train.jsonl`, without a last one that was cut short.

    :raises ValueError: naming file and line, when another is damaged.
    """
    try:
        text = path.read_text('utf-8') if path.exists() else ''
    except UnicodeDecodeError as error:
        raise ValueError(f'{path}: damaged: {error}') from error
    lines = []
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        if not line.endswith('\n'):
            break
        try:
            lines.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            raise ValueError(f'{path}: line {number} is damaged: {error}') from error
    return lines
