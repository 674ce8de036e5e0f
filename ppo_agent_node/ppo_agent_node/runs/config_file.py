# SPDX-License-Identifier: Apache-2.0
"""The settings of a run on disk, `config.yaml`, as all who need them read them."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

_LARGEST = 100_000
"""bytes; all settings there are take some thousands, and a parser takes long for rubbish"""


class _PlainLoader(yaml.SafeLoader):
    """Names and values, without references: those few bytes can stand for more than all memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return what stands next.

        :raises yaml.YAMLError: when it refers to something else.
        """
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('refers to another value, expected plain values')
        return super().compose_node(parent, index)


def read_config(path: Path) -> dict[str, Any]:
    """Return the settings by name, `{}` where there is no such file.

    :raises ValueError: naming the file, when it is damaged.
    :raises OSError: when it cannot be read.
    """
    if not path.is_file():
        return {}
    size = path.stat().st_size
    if size > _LARGEST:
        raise ValueError(f'{path}: damaged, {size} bytes, expected at most {_LARGEST}')
    try:
        # A kind of safe loader: it makes nothing but plain values.
        values = yaml.load(path.read_text('utf-8'), _PlainLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f'{path}: damaged: {" ".join(str(error).split())}') from error
    if not isinstance(values, dict):
        raise ValueError(f'{path}: damaged, expected names and values')
    return values
