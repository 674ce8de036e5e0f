# SPDX-License-Identifier: Apache-2.0
"""Entities of a YAML launch file: typed access to attributes, and errors that name the place."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ros2.errors import FULL
from ros2.errors import unknown
from ros2.launch.context import LaunchError

_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    'arg': ('default', 'description', 'name'),
    'group': (),
    'node': (
        'exec', 'if', 'name', 'on_exit', 'output', 'param', 'pkg', 'respawn', 'respawn_delay',
        'sigterm_timeout'),
    'push_ros_namespace': ('namespace',),
}


class Entity:
    """One entity: its kind, its attributes or those inside it, and where it stands."""

    def __init__(self, kind: str, data: Any, where: str) -> None:
        """Check that the kind and all attributes are known."""
        self.kind = kind
        self.where = f'{where}: {kind}'
        self.data: dict[str, Any] = {}
        self.children: list[Entity] = []
        if kind not in _ATTRIBUTES:
            raise LaunchError(f'{where}: ' + unknown(f"entity '{kind}'", _ATTRIBUTES), True)
        if kind == 'group':
            if isinstance(data, dict):
                raise self.error(unknown('a group with attributes', ['a list of entities']))
            self.children = _entities(data, self.where)
            return
        if not isinstance(data, dict):
            raise self.error(f'expected attributes and values, got {data!r}')
        self.data = data
        label = data.get('exec') or data.get('name')
        if isinstance(label, str):
            self.where += f" '{label}'"
        for key in data:
            if key not in _ATTRIBUTES[kind]:
                raise self.error(unknown(f"attribute '{key}'", _ATTRIBUTES[kind]))

    def error(self, text: str) -> LaunchError:
        """Return an error that names this entity."""
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

    def seconds(self, key: str, default: float) -> float:
        """Return a number of seconds, at least 0."""
        value = self.data.get(key, default)
        if not isinstance(value, int | float) or isinstance(value, bool) or value < 0:
            raise self.error(f"'{key}' must be a number, not negative, got {value!r}")
        return value

    def flag(self, key: str) -> bool:
        """Return whether an attribute is there and true."""
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise self.error(f"'{key}' must be true or false, got {value!r}")
        return value

    def items(self, key: str) -> list[dict[str, Any]]:
        """Return a list of dictionaries, empty when the attribute is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(f"'{key}' must be a list of entries with keys and values")
        return value


def _entities(items: Any, where: str) -> list[Entity]:
    if not isinstance(items, list):
        raise LaunchError(f'{where}: expected a list of entities, got {items!r}', True)
    result = []
    for number, item in enumerate(items, 1):
        if not isinstance(item, dict) or len(item) != 1:
            raise LaunchError(
                f'{where}: entity {number} must have one key, which says what it is, got {item!r}',
                True)
        (kind, data), = item.items()
        result.append(Entity(str(kind), data, where))
    return result


def load(path: Path) -> list[Entity]:
    """Return the entities of a launch file, all kinds and attributes checked.

    :raises LaunchError: when it cannot be read or is not a YAML launch file that we support.
    """
    if path.suffix in ('.py', '.xml'):
        raise LaunchError(f'{path}: only YAML launch files are supported here; {FULL}', True)
    try:
        data = yaml.safe_load(path.read_text())
    except OSError as error:
        raise LaunchError(f'{path}: {error.strerror}', True) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise LaunchError(f'{path}: not valid YAML: {error}', True) from None
    if not isinstance(data, dict) or set(data) != {'launch'}:
        raise LaunchError(f"{path}: expected 'launch' as root tag", True)
    return _entities(data['launch'], str(path))
