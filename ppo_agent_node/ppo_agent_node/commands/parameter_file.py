# SPDX-License-Identifier: Apache-2.0
"""Files of ROS parameters: read for what they say to a node, and written with more in them."""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ppo_agent_node.atomic_file import write_atomically

_ALL, _KEY = '/**', 'ros__parameters'


def _sections(path: Path, text: str, node: str) -> dict[str, dict[str, Any]]:
    """Return the parameters of each section of a file that speaks to a node."""
    try:
        content = yaml.safe_load(text) or {}
        found = {
            name: section[_KEY] or {} for name, section in content.items()
            if name.rpartition('/')[2] in ('**', '*', node)}
        if not all(isinstance(values, dict) for values in found.values()):
            raise TypeError('expected names and values')
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(
            f'{path}: got {" ".join(str(error).split())!r:.200}, expected a file of ROS parameters'
        ) from error
    return found


def read_parameters(path: Path, node: str) -> dict[str, Any]:
    """Return the parameters that a file gives a node, by name.

    :raises ValueError: naming the file, when it is none of parameters.
    :raises OSError: when it cannot be read.
    """
    values: dict[str, Any] = {}
    for section in _sections(path, path.read_text('utf-8'), node).values():
        values.update(section)
    return values


def write_parameters(
    path: Path, node: str, values: Mapping[str, Any], base: Path | None = None,
) -> None:
    """Write a file of parameters of a node.

    :param base: a file whose parameters hold beside `values`.
    :raises ValueError: when that is no file of parameters.
    :raises OSError: when it cannot be read, or the other not be written.
    """
    sections = _sections(base, base.read_text('utf-8'), node) if base else {}
    sections = sections or {_ALL: {}}
    plain = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in values.items()}
    for section in sections.values():  # the most specific one would win
        section.update(plain)
    text = yaml.safe_dump(
        {name: {_KEY: section} for name, section in sections.items()},
        sort_keys=False, default_flow_style=None)
    write_atomically(path, text.encode())
