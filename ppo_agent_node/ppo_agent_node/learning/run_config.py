# SPDX-License-Identifier: Apache-2.0
"""The settings of a run on disk, `config.yaml`, as all who need them read them."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml


def read_config(path: Path) -> dict[str, Any]:
    """Return the settings by name, `{}` where there is no such file.

    :raises ValueError: naming the file, when it is damaged.
    :raises OSError: when it cannot be read.
    """
    if not path.is_file():
        return {}
    try:
        values = yaml.safe_load(path.read_text('utf-8'))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f'{path}: damaged: {" ".join(str(error).split())}') from error
    if not isinstance(values, dict):
        raise ValueError(f'{path}: damaged, expected names and values')
    return values
