# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: from `param` entries to arguments of its command line."""
from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import yaml

from ros2.errors import FULL
from ros2.errors import unknown
from ros2.launch.context import Context
from ros2.launch.entity import Entity
from ros2.launch.substitutions import resolve
from ros2.launch.substitutions import substitute

_TYPES = {'str': str, 'int': int, 'float': float, 'bool': bool}
_KEYS = ('name', 'value', 'type', 'from')


def typed(value: Any, context: Context, entity: Entity, kind: str | None = None) -> Any:
    """Return the value of a parameter.

    A value without substitutions keeps the type it has in the YAML file; the text that
    substitutions result in is read by the rules of YAML again, so that $(var n) with n:=3 is an
    integer; `kind` (str, int, float, bool) asks for a type instead.

    :raises LaunchError: when it is none of these types.
    """
    result = value
    if isinstance(value, str):
        result, substituted = resolve(value, context)
        if kind != 'str' and (substituted or kind is not None):
            result = _from_yaml(result)
    if kind == 'float' and type(result) is int:
        result = float(result)
    if kind is None and isinstance(result, list):
        raise entity.error(unknown(f'parameter value {result!r}', ['single values']))
    if type(result) not in (_TYPES.values() if kind is None else (_TYPES[kind],)):
        raise entity.error(
            f'parameter value {value!r} results in {result!r}, which is not '
            f'{kind or "a boolean, integer, double or string"}')
    return result


def _from_yaml(text: str) -> Any:
    if not text:
        return text
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return text


def _parameter(item: dict[str, Any], context: Context, entity: Entity) -> tuple[str, Any]:
    for key in item:
        if key not in _KEYS:
            raise entity.error(unknown(f"attribute '{key}' of a param", _KEYS))
    if not isinstance(item.get('name'), str) or 'value' not in item:
        raise entity.error(f"each param needs 'name' and 'value', or 'from' alone, got {item!r}")
    name = substitute(item['name'], context)
    kind = item.get('type')
    if kind is not None and str(kind) not in _TYPES:
        raise entity.error(unknown(f"type '{kind}' of parameter '{name}'", _TYPES))
    return name, typed(item['value'], context, entity, kind)


def arguments(entity: Entity, node: str, context: Context) -> list[str]:
    """Return command line arguments that carry the parameters of a node, later ones winning.

    `node` is its full name, or /** where that is not known.

    :raises LaunchError: when a value is wrong or a file is missing.
    """
    result = []
    values: dict[str, Any] = {}
    for item in entity.items('param'):
        if 'from' not in item:
            name, value = _parameter(item, context, entity)
            values[name] = value
            continue
        if set(item) != {'from'}:
            raise entity.error(f"'from' must be the only key of a param, got {item!r}; {FULL}")
        if values:
            result += ['--params-file', _write(node, values, context)]
            values = {}
        path = substitute(str(item['from']), context)
        try:
            if Path(path).exists() and not Path(path).is_file():
                raise entity.error(f"parameter file '{path}': not a regular file")
            open(path).close()
        except OSError as error:
            raise entity.error(f"parameter file '{path}': {error.strerror}") from None
        result += ['--params-file', path]
    if values:
        result += ['--params-file', _write(node, values, context)]
    return result


def _write(node: str, values: dict[str, Any], context: Context) -> str:
    context.log_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(
            mode='w', prefix='launch_params_', dir=context.log_dir, delete=False) as file:
        yaml.dump({node: {'ros__parameters': values}}, file, default_flow_style=False)
    return file.name
