# SPDX-License-Identifier: Apache-2.0
"""Settings: frozen dataclasses whose fields declare unit, range and description.

One declaration serves the core, the ROS parameters and the documentation.
"""
from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any
from typing import TypeVar
from typing import cast

S = TypeVar('S')
Value = bool | int | float | str | tuple[int, ...]


@dataclass(frozen=True)
class SettingInfo:
    """Description of one setting; its type is that of `default`.

    `low` and `high` are inclusive bounds of numbers, or of each number in a list. `choices`, if
    not empty, are the allowed strings.
    """

    name: str
    default: Value
    unit: str
    description: str
    low: float
    high: float
    choices: tuple[str, ...]


def setting(
    default: Value,
    unit: str,
    description: str,
    low: float = 0.0,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare a dataclass field as a setting with unit, range and description."""
    return dataclasses.field(default=default, metadata={
        'unit': unit, 'description': description, 'low': low, 'high': high, 'choices': choices,
    })


def describe(cls: type) -> tuple[SettingInfo, ...]:
    """Return the settings of a dataclass in order of declaration."""
    return tuple(
        SettingInfo(field.name, cast(Value, field.default), **field.metadata)
        for field in dataclasses.fields(cls)
    )


def check(info: SettingInfo, value: object) -> Value:
    """Return `value` converted to the type of the setting `info`.

    :raises TypeError: when it is of the wrong type.
    :raises ValueError: when it is not finite, outside the range or not one of the choices.
    """
    if isinstance(info.default, tuple):
        if isinstance(value, str) or not hasattr(value, '__iter__') or _shape(value) == ():
            raise TypeError(f'{info.name}: got {value!r}, expected a list of whole numbers')
        return tuple(int(_number(info, item, whole=True)) for item in value)
    if isinstance(info.default, bool | str):
        if not isinstance(value, type(info.default)):
            kind = 'true or false' if isinstance(info.default, bool) else 'a string'
            raise TypeError(f'{info.name}: got {value!r}, expected {kind}')
        if info.choices and value not in info.choices:
            choices = ', '.join(choice or "''" for choice in info.choices)
            raise ValueError(f'{info.name}: got {value!r}, expected one of {choices}')
        return value
    number = _number(info, value, whole=isinstance(info.default, int))
    return int(number) if isinstance(info.default, int) else number


def whole_number(name: str, value: object, low: int, high: int, shown_high: str = '') -> int:
    """Return a whole number, also one of NumPy, as an `int`.

    :param shown_high: how the message writes `high`, if not in digits.
    :raises ValueError: when it is none, or out of range.
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or not low <= int(value) <= high:
        raise ValueError(
            f'{name}: got {value!r:.80}, expected a whole number from {low} to '
            f'{shown_high or high}')
    return int(value)


def _number(info: SettingInfo, value: object, *, whole: bool) -> float:
    # Arrays and tensors can be converted as well, but only those of one number.
    if (isinstance(value, bool | str) or not hasattr(value, '__float__') or _shape(value)
            or getattr(getattr(value, 'dtype', None), 'kind', 'f') not in 'fiu'):
        raise TypeError(
            f'{info.name}: got {" ".join(repr(value).split()):.200}, expected a number')
    # Not via float, which would round whole numbers above 2**53.
    number = int(value) if whole and isinstance(value, Integral) else as_float(value)
    finite = isinstance(number, int) or math.isfinite(number)
    if not (finite and info.low <= number <= info.high):
        raise ValueError(
            f'{info.name}: got {value!r:.200}, '
            f'expected {info.low:g} to {info.high:g} {info.unit}'.rstrip()
        )
    if whole and number != math.floor(number):
        raise TypeError(f'{info.name}: got {value!r}, expected a whole number')
    return number


def _shape(value: object) -> object:
    """Return the shape of an array or a tensor, None for anything else."""
    return getattr(value, 'shape', None)


def as_float(value: Any) -> float:
    """Return a number as a float; infinite if it is an integer too large for one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def build(cls: type[S], values: Mapping[str, object]) -> S:
    """Create a settings dataclass from values by name; the rest have their defaults.

    :raises ValueError: for an unknown name or a value out of range.
    :raises TypeError: for a value of the wrong type.
    """
    infos = {info.name: info for info in describe(cls)}
    unknown = sorted(set(values) - set(infos))
    if unknown:
        raise ValueError(
            f'unknown setting {", ".join(map(repr, unknown))}, expected {", ".join(infos)}')
    return cls(**{name: check(infos[name], value) for name, value in values.items()})


def changed(settings: S, changes: Mapping[str, object], allowed: Sequence[str]) -> S:
    """Return a settings dataclass with other values of some settings.

    :param allowed: names of the settings that may change.
    :raises ValueError: for a name that is not allowed or a value out of range.
    :raises TypeError: for a value of the wrong type.
    """
    unknown = sorted(set(changes) - set(allowed))
    if unknown:
        raise ValueError(
            f'unknown setting {", ".join(map(repr, unknown))}, expected {", ".join(allowed)}')
    return build(type(settings), {**as_dict(settings), **changes})


def as_dict(settings: object) -> dict[str, Any]:
    """Return all settings by name."""
    return dataclasses.asdict(settings)  # type: ignore[call-overload,no-any-return]


def as_numbers(settings: object) -> dict[str, float]:
    """Return all settings by name as numbers; a choice becomes its index."""
    choices = {info.name: info.choices for info in describe(type(settings))}
    return {
        name: choices[name].index(value) if choices[name] else value
        for name, value in as_dict(settings).items()}


def from_number(info: SettingInfo, value: Any) -> Any:
    """Return the value that a number of `as_numbers` represents; anything else unchanged."""
    if isinstance(info.default, bool) and value in (0, 1):
        return bool(value)
    if info.choices and not isinstance(value, str) and value in range(len(info.choices)):
        return info.choices[int(value)]
    return value
