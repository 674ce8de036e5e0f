# SPDX-License-Identifier: Apache-2.0
"""Entries of a YAML launch file: typed access to their keys, and errors that name the place."""
from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from ros2.launch.context import LaunchError

_CONDITIONS = {'if', 'unless'}
_PROCESS = {
    'name', 'cwd', 'env', 'output', 'on_exit', 'respawn', 'respawn_delay', 'respawn_max_retries',
    'sigterm_timeout', 'sigkill_timeout', 'launch-prefix', *_CONDITIONS,
}
_KEYS: dict[str, set[str]] = {
    'arg': {'name', 'default', 'description', 'choice', *_CONDITIONS},
    'let': {'name', 'value', *_CONDITIONS},
    'set_env': {'name', 'value', *_CONDITIONS},
    'unset_env': {'name', *_CONDITIONS},
    'log': {'message', *_CONDITIONS},
    'push_ros_namespace': {'namespace', *_CONDITIONS},
    'push-ros-namespace': {'namespace', *_CONDITIONS},
    'group': {'children', 'scoped', *_CONDITIONS},
    'include': {'file', 'arg', *_CONDITIONS},
    'executable': {'cmd', 'shell', *_PROCESS},
    'node': {'pkg', 'exec', 'exec_name', 'namespace', 'args', 'ros_args', 'param', 'remap',
             *_PROCESS},
}


class Entity:
    """One entry: its kind, its keys, and where it stands."""

    def __init__(self, kind: str, data: Any, where: str) -> None:
        """Check that the kind and all keys are known."""
        self.kind = kind
        self.where = f'{where}: {kind}'
        if kind not in _KEYS:
            raise LaunchError(
                f"{where}: entry '{kind}' is not supported, only {', '.join(sorted(_KEYS))}", True)
        if kind == 'group' and isinstance(data, list):
            data = {'children': data}
        if not isinstance(data, dict):
            raise LaunchError(f'{self.where}: expected keys and values, got {data!r}', True)
        self.data: dict[str, Any] = data
        label = data.get('exec') or data.get('name')
        if isinstance(label, str):
            self.where += f" '{label}'"
        for key in data:
            if key not in _KEYS[kind]:
                raise self.error(
                    f"key '{key}' is not supported here, only {', '.join(sorted(_KEYS[kind]))}")

    def error(self, text: str) -> LaunchError:
        """Return an error that names this entry."""
        return LaunchError(f'{self.where}: {text}', placed=True)

    def get(self, key: str) -> str | None:
        """Return a text, or None.

        :raises LaunchError: when it is something else; YAML reads 1 and true as no texts.
        """
        value = self.data.get(key)
        if value is None or isinstance(value, str):
            return value
        raise self.error(
            f"'{key}' must be a text, got {value!r} ({type(value).__name__}); quote it")

    def need(self, key: str) -> str:
        """Return a text that must be there."""
        value = self.get(key)
        if value is None:
            raise self.error(f"'{key}' is missing")
        return value

    def number(self, key: str, default: float) -> float:
        """Return a number of seconds or a count, at least 0 (or -1 for no limit)."""
        value = self.data.get(key, default)
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or value < min(default, 0):
            raise self.error(f"'{key}' must be a number, not negative, got {value!r}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self.data.get(key, default)
        if not isinstance(value, bool):
            raise self.error(f"'{key}' must be true or false, got {value!r}")
        return value

    def items(self, key: str) -> list[dict[str, Any]]:
        """Return a list of dictionaries, empty when the key is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(f"'{key}' must be a list of entries with keys and values")
        return value

    def pairs(self, key: str, first: str, second: str) -> Iterator[tuple[str, str]]:
        """Return two texts of each item of a list, such as name and value."""
        for item in self.items(key):
            if set(item) != {first, second} or not all(isinstance(v, str) for v in item.values()):
                raise self.error(
                    f"each item of '{key}' needs the texts '{first}' and '{second}', got {item!r}")
            yield item[first], item[second]

    def children(self) -> list[Entity]:
        """Return the entries of a group."""
        return _entities(self.data.get('children'), self.where)


def _entities(items: Any, where: str) -> list[Entity]:
    if not isinstance(items, list):
        raise LaunchError(f'{where}: expected a list of entries, got {items!r}', True)
    result = []
    for number, item in enumerate(items, 1):
        if not isinstance(item, dict) or len(item) != 1:
            raise LaunchError(
                f'{where}: entry {number} must have one key, which says what it is, got {item!r}',
                True)
        (kind, data), = item.items()
        entity = Entity(str(kind), data, where)
        if kind == 'group':
            entity.children()
        result.append(entity)
    return result


def load(path: Path) -> list[Entity]:
    """Return the entries of a launch file, all kinds and keys checked.

    :raises LaunchError: when it cannot be read or is not a YAML launch file that we support.
    """
    if path.suffix in ('.py', '.xml'):
        raise LaunchError(
            f'{path}: only YAML launch files are supported here; others need a full ROS 2', True)
    try:
        data = yaml.safe_load(path.read_text())
    except OSError as error:
        raise LaunchError(f'{path}: {error.strerror}', True) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise LaunchError(f'{path}: not valid YAML: {error}', True) from None
    if not isinstance(data, dict) or set(data) != {'launch'}:
        raise LaunchError(f"{path}: expected 'launch' as root tag", True)
    return _entities(data['launch'], str(path))
