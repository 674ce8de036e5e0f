# SPDX-License-Identifier: Apache-2.0
"""Messages as YAML text, and YAML values as messages."""
from __future__ import annotations

import array
import sys
from typing import Any

import numpy as np
import yaml

from ros2.errors import CommandError


def to_plain(
    value: Any, *, truncate: int | None = None, no_arr: bool = False, no_str: bool = False,
    type_name: str = '',
) -> Any:
    """Return a message, or the value of a field, as dictionaries, lists and scalars.

    Lists and texts longer than `truncate` end with '...'; `no_arr` and `no_str` put a remark in
    the place of arrays and texts.
    """
    options: dict[str, Any] = {'truncate': truncate, 'no_arr': no_arr, 'no_str': no_str}
    if hasattr(value, 'get_fields_and_field_types'):
        return {
            name: to_plain(getattr(value, name), type_name=kind, **options)
            for name, kind in value.get_fields_and_field_types().items()}
    if isinstance(value, bytes):  # of one field of kind byte, as ROS 2 prints it
        value = ''.join(map(chr, value))
    if isinstance(value, str):
        if no_str:
            return f'<string length: <{len(value)}>>'
        return value if truncate is None or len(value) <= truncate else value[:truncate] + '...'
    if isinstance(value, list | tuple | array.array | np.ndarray):
        if no_arr:
            return _remark(value, type_name)
        cut = value if truncate is None else value[:truncate]
        plain = cut.tolist() if isinstance(cut, array.array | np.ndarray) else list(cut)
        items = [to_plain(item, **options) for item in plain]
        return items if len(cut) == len(value) else [*items, '...']
    return value.item() if isinstance(value, np.generic) else value


def _remark(value: Any, type_name: str) -> str:
    element, bracket, _ = type_name.partition('[')
    if bracket:
        return f'<array type: {element}[{len(value)}]>'
    element = type_name.removeprefix('sequence<').removesuffix('>').partition(',')[0]
    return f'<sequence type: {element}, length: {len(value)}>'


def to_yaml(value: Any, flow_style: bool = False, **options: Any) -> str:
    """Return a message as the text that the real command prints."""
    return yaml.safe_dump(
        to_plain(value, **options), allow_unicode=True, width=sys.maxsize,
        default_flow_style=flow_style, sort_keys=False)


def to_csv(value: Any, **options: Any) -> str:
    """Return all scalars of a message, separated by commas."""
    def leaves(plain: Any) -> list[str]:
        if isinstance(plain, dict):
            return [leaf for item in plain.values() for leaf in leaves(item)]
        if isinstance(plain, list):
            return [leaf for item in plain for leaf in leaves(item)]
        return [str(plain)]
    return ','.join(leaves(to_plain(value, **options)))


def fill(message: Any, values: Any, where: str = '') -> None:
    """Set fields of a message from a dictionary.

    :raises CommandError: when a field does not exist or a value does not fit.
    """
    if not isinstance(values, dict):
        raise CommandError(
            f'Failed to populate field{where}: expected a dictionary, got {values!r}')
    for name, value in values.items():
        try:
            old = getattr(message, name)
            if hasattr(old, 'get_fields_and_field_types'):
                fill(old, value, f'{where} {name}')
                continue
            setattr(message, name, _fitting(message, name, old, value))
        except CommandError:
            raise
        except (AttributeError, AssertionError, TypeError, ValueError) as error:
            raise CommandError(f'Failed to populate field:{where} {name}: {error}') from None


def _fitting(message: Any, name: str, old: Any, value: Any) -> Any:
    from ros2.graph import load_type
    if isinstance(old, float) and not isinstance(value, bool | str):
        return float(value)
    if isinstance(old, array.array):
        return array.array(old.typecode, value)
    if isinstance(old, list) and isinstance(value, list) and value and isinstance(value[0], dict):
        kind = message.get_fields_and_field_types()[name]
        kind = kind.removeprefix('sequence<').removesuffix('>').partition(',')[0].partition('[')[0]
        items = []
        for item in value:
            element = load_type(kind, 'msg')()
            fill(element, item, f' {name}')
            items.append(element)
        return items
    return value
