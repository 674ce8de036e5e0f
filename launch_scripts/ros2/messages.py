# SPDX-License-Identifier: Apache-2.0
"""Messages as YAML text, and YAML values as messages."""
from __future__ import annotations

import array
import sys
from typing import Any

import numpy as np
import yaml

from ros2.errors import CommandError

_LONGEST = 128
"""items of a list, characters of a text"""


def to_plain(value: Any) -> Any:
    """Return a message, or the value of a field, as dictionaries, lists and scalars.

    Lists and texts that are longer than the real command prints them end with '...'.
    """
    if hasattr(value, 'get_fields_and_field_types'):
        return {name: to_plain(getattr(value, name)) for name in
                value.get_fields_and_field_types()}
    if isinstance(value, bytes):  # of one field of kind byte, as ROS 2 prints it
        value = ''.join(map(chr, value))
    if isinstance(value, str):
        return value if len(value) <= _LONGEST else value[:_LONGEST] + '...'
    if isinstance(value, list | tuple | array.array | np.ndarray):
        cut = value[:_LONGEST]
        plain = cut.tolist() if isinstance(cut, array.array | np.ndarray) else list(cut)
        items = [to_plain(item) for item in plain]
        return items if len(cut) == len(value) else [*items, '...']
    return value.item() if isinstance(value, np.generic) else value


def to_yaml(value: Any) -> str:
    """Return a message as the text that the real command prints."""
    return yaml.safe_dump(
        to_plain(value), allow_unicode=True, width=sys.maxsize, default_flow_style=False,
        sort_keys=False)


def fill_from_yaml(message: Any, text: str, failure: str) -> None:
    """Set fields of a message from YAML text; empty text leaves them as they are.

    :param failure: begins the error for text that is not YAML.
    :raises CommandError: when it is not YAML, a field does not exist or a value does not fit.
    """
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CommandError(f'{failure}: {error}') from None
    fill(message, values or {})


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
