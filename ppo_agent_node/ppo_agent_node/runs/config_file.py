# SPDX-License-Identifier: Apache-2.0
"""Reader of a run's settings file, `config.yaml`."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

_LARGEST = 100_000
"""Maximum bytes; all settings take some thousands, and parsing a large invalid file is slow."""


class _PlainLoader(yaml.SafeLoader):
    """Loader without YAML references, a few bytes of which can expand to more than all memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node.

        :raises yaml.YAMLError: when it is a reference.
        """
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('refers to another value, expected plain values')
        return super().compose_node(parent, index)


def read_config(path: Path) -> dict[str, Any]:
    """Return the settings by name, `{}` if there is no such file.

    :raises ValueError: naming the file, when it is damaged.
    :raises OSError: when it cannot be read.
    """
    if not path.is_file():
        return {}
    size = path.stat().st_size
    if size > _LARGEST:
        raise ValueError(f'{path}: damaged, {size} bytes, expected at most {_LARGEST}')
    try:
        # Derived from the safe loader, so it constructs plain values only.
        values = yaml.load(path.read_text('utf-8'), _PlainLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f'{path}: damaged: {" ".join(str(error).split())}') from error
    if not isinstance(values, dict):
        raise ValueError(f'{path}: damaged, expected names and values')
    return values
