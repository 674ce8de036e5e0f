# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: from `param` entries to arguments of its command line."""
from __future__ import annotations

import tempfile
from typing import Any

import yaml

from ros2.launch.context import Context
from ros2.launch.entity import Entity
from ros2.launch.substitutions import parse
from ros2.launch.substitutions import perform
from ros2.launch.substitutions import substitute

_TYPES = {'str': str, 'int': int, 'float': float, 'bool': bool}
_SCALARS = (bool, int, float, str)


def typed(value: Any, context: Context, entity: Entity, kind: str | None = None) -> Any:
    """Return the value of a parameter.

    A value without substitutions keeps the type it has in the YAML file; the text that
    substitutions result in is read by the rules of YAML again, so that $(var n) with n:=3 is an
    integer; `kind` (str, int, float, bool) asks for a type instead.

    :raises LaunchError: when it is none of the types that parameters have.
    """
    if isinstance(value, list):
        items = [typed(item, context, entity, kind) for item in value]
        if {type(item) for item in items} == {int, float}:
            items = [float(item) for item in items]
        if len({type(item) for item in items}) > 1:
            raise entity.error(f'all items of a list must have one type, got {items!r}')
        return items
    if not isinstance(value, str):
        result = value
    else:
        template = parse(value)
        text = perform(template, context)
        plain = not any(not isinstance(part, str) for part in template)
        result = text if (plain and kind is None) or kind == 'str' else _from_yaml(text)
    if kind == 'float' and type(result) is int:
        result = float(result)
    wanted = _SCALARS if kind is None else (_TYPES[kind],)
    if isinstance(result, list) and kind is None and all(isinstance(x, _SCALARS) for x in result):
        return result
    if type(result) not in wanted:
        raise entity.error(
            f'parameter value {value!r} results in {result!r}, which is not '
            f'{kind or "a boolean, integer, double, string or a list of them"}')
    return result


def _from_yaml(text: str) -> Any:
    if not text:
        return text
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return text


def _flat(item: dict[str, Any], prefix: str, context: Context, entity: Entity) -> dict[str, Any]:
    """Return the parameters of one item by full name; nested ones are joined with dots."""
    unknown = set(item) - {'name', 'value', 'type', 'param'}
    if unknown or not isinstance(item.get('name'), str) or ('value' in item) == ('param' in item):
        raise entity.error(
            f"each param needs 'name' and either 'value' or 'param', or 'from' alone, "
            f'got {item!r}')
    name = prefix + substitute(item['name'], context)
    if 'param' in item:
        result = {}
        for inner in item['param']:
            result.update(_flat(inner, f'{name}.', context, entity))
        return result
    kind = item.get('type')
    if kind is not None and kind not in _TYPES:
        raise entity.error(
            f"type '{kind}' of parameter '{name}' is not one of {', '.join(_TYPES)}")
    return {name: typed(item['value'], context, entity, kind)}


def arguments(entity: Entity, node: str, context: Context) -> list[str]:
    """Return command line arguments that carry the parameters of a node, later ones winning.

    `node` is its full name, or /** where that is not known.

    :raises LaunchError: when a value is wrong or a file is missing.
    """
    result = []
    values: dict[str, Any] = {}
    for item in entity.items('param'):
        if 'from' not in item:
            values.update(_flat(item, '', context, entity))
            continue
        if set(item) != {'from'}:
            raise entity.error(f"'from' of a param stands alone, got {item!r}")
        if values:
            result += ['--params-file', _write(node, values, context)]
            values = {}
        path = substitute(str(item['from']), context)
        try:
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
