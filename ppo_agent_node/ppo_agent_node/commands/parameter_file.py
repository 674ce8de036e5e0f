# SPDX-License-Identifier: Apache-2.0
"""Files of ROS parameters: the values for a node are read, or more are added."""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from typing import cast

import yaml

from ppo_agent_node.atomic_file import write_atomically

_ALL, _KEY = '/**', 'ros__parameters'


def _load(path: Path) -> dict[str, Any]:
    """Return the content of a file of parameters.

    :raises ValueError: naming the file, when it is none.
    :raises OSError: when it cannot be read.
    """
    try:
        content = yaml.safe_load(path.read_text('utf-8')) or {}
        list(_sections(content, ''))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(
            f'{path}: got {" ".join(str(error).split())!r:.200}, expected a file of ROS parameters'
        ) from error
    return cast(dict[str, Any], content)


def _sections(content: Any, node: str, name: str = '') -> Iterator[dict[str, Any]]:
    """Yield the parameters, by name, of each section that applies to a node.

    :raises ValueError: for what is no section.
    """
    if not isinstance(content, dict):
        raise ValueError(content)
    for key, section in content.items():
        if key != _KEY:
            yield from _sections(section, node, str(key))
        elif not isinstance(section, dict):
            raise ValueError(section)
        elif name.rpartition('/')[2] in ('**', '*', node):
            yield section


def read_parameters(path: Path, node: str) -> dict[str, Any]:
    """Return the parameters that a file gives a node, by name.

    :raises ValueError: naming the file, when it is none of parameters.
    :raises OSError: when it cannot be read.
    """
    values: dict[str, Any] = {}
    for section in _sections(_load(path), node):
        values.update(section)
    return values


def write_parameters(
    path: Path, node: str, values: Mapping[str, Any], base: Path | None = None,
) -> None:
    """Write a file of parameters of a node.

    :param base: a file whose parameters are kept, except for those in `values`.
    :raises ValueError: when that is no file of parameters.
    :raises OSError: when it cannot be read, or the other not be written.
    """
    content = _load(base) if base else {}
    if not any(True for _ in _sections(content, node)):
        content[_ALL] = {_KEY: {}}
    for section in _sections(content, node):  # the most specific one would win
        section.update({
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()})
    write_atomically(
        path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None).encode())
