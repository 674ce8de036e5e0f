# SPDX-License-Identifier: Apache-2.0
"""Files of ROS parameters: the values for a node are read, or more are added.

Which sections of a file are for a node is decided as rcl does, by its full name: `/**` stands for
any number of namespaces or names, `/*` for one.
"""
from __future__ import annotations

import re
from collections.abc import Iterator
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from typing import cast

import yaml

from ppo_agent_node.atomic_file import write_atomically
from rocket_sim_node import input_file
from rocket_sim_node import plain_yaml

LARGEST = 1_000_000
"""Maximum bytes of a file; all parameters of a node take some thousands."""
_ALL, _KEY = '/**', 'ros__parameters'
_SHOWN = 5
"""Names of nodes that an error lists at most."""
_PATTERNS = {'**': r'(/\w+)*', '*': r'/\w+'}


def _load(path: Path) -> dict[str, Any]:
    """Return the content of a file of parameters.

    :raises ValueError: naming the file, when it is none.
    :raises OSError: when it cannot be read.
    """
    text = input_file.read_text(path, LARGEST)
    try:
        content = plain_yaml.load(text) or {}
        list(_sections(content))
    except plain_yaml.ERRORS as error:
        raise ValueError(
            f'{path}: got {" ".join(str(error).split())!r:.200}, expected a file of ROS parameters'
        ) from error
    return cast(dict[str, Any], content)


def _sections(content: Any, name: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each section of parameters, by name, with the full name of the nodes it is for.

    :raises ValueError: for what is no section.
    """
    if not isinstance(content, dict):
        raise ValueError(content)
    for key, section in content.items():
        if key != _KEY:
            yield from _sections(section, f'{name}/{str(key).strip("/")}')
        elif not isinstance(section, dict):
            raise ValueError(section)
        else:
            yield name, section


def _is_for(name: str, node: str) -> bool:
    """Return whether the name of a section is that of a node, or a pattern of it."""
    pattern = ''.join(
        _PATTERNS.get(part, f'/{re.escape(part)}') for part in name.strip('/').split('/'))
    return re.fullmatch(pattern, node) is not None


def _sections_for(content: Any, node: str) -> list[dict[str, Any]]:
    return [section for name, section in _sections(content) if _is_for(name, node)]


def read_parameters(path: Path, node: str) -> dict[str, Any]:
    """Return the parameters that a file gives a node, by name.

    :param node: its full name.
    :raises ValueError: naming the file, when it is none of parameters.
    :raises OSError: when it cannot be read.
    """
    values: dict[str, Any] = {}
    for section in _sections_for(_load(path), node):
        values.update(section)
    return values


def require_parameters(argument: str, path: Path, node: str) -> None:
    """Check that a file that was named gives parameters to the node that it was named for.

    ROS would drop a file of other nodes, or an empty one, in silence.

    :param argument: that names the file.
    :param node: its full name.
    :raises ValueError: naming the argument, the file, the nodes in it and the one expected.
    """
    try:
        content = _load(path)
    except OSError as error:
        reason = 'no file' if isinstance(error, FileNotFoundError) else f'{error.strerror}:'
        raise ValueError(f'{argument}: {reason} {path}') from error
    except ValueError as error:
        raise ValueError(f'{argument}: {error}') from error
    if any(_sections_for(content, node)):
        return
    names = [name for name, section in _sections(content) if section]
    found = ', '.join(names[:_SHOWN]) + (', …' if len(names) > _SHOWN else '')
    raise ValueError(
        f'{argument}: {path} has no parameters for node {node}: got those of '
        f'{found or "no node"}, expected some of {_ALL}, {_ALL}/{node.rpartition("/")[2]} or '
        f'{node}')


def write_parameters(
    path: Path, node: str, values: Mapping[str, Any], base: Path | None = None,
) -> None:
    """Write a file of parameters of a node.

    :param node: its full name.
    :param base: a file whose parameters are kept, except for those in `values`.
    :raises ValueError: when that is no file of parameters.
    :raises OSError: when it cannot be read, or the other not be written.
    """
    content = _load(base) if base else {}
    if not _sections_for(content, node):
        content[_ALL] = {_KEY: {}}
    for section in _sections_for(content, node):  # the last one would win
        section.update({
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()})
    write_atomically(
        path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None).encode())
