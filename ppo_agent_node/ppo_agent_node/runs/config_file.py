# SPDX-License-Identifier: Apache-2.0
"""Reader of a run's settings file, `config.yaml`."""
from __future__ import annotations

from pathlib import Path
from typing import Any

from rocket_sim_node import input_file
from rocket_sim_node import plain_yaml

_LARGEST = 100_000
"""Maximum bytes; all settings take some thousands, and parsing a large invalid file is slow."""


def read_config(path: Path) -> dict[str, Any]:
    """Return the settings by name, `{}` if there is no such file.

    :raises ValueError: naming the file, when it is damaged.
    :raises OSError: when it cannot be read.
    """
    if not path.exists():
        return {}
    text = input_file.read_text(path, _LARGEST)
    try:
        values = plain_yaml.load(text)
    except plain_yaml.ERRORS as error:
        raise ValueError(f'{path}: damaged: {" ".join(str(error).split())}') from error
    if not isinstance(values, dict):
        raise ValueError(f'{path}: damaged, expected names and values')
    return values
