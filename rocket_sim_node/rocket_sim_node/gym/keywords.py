# SPDX-License-Identifier: Apache-2.0
"""Check of the keywords of `gymnasium.make` and `make_vec`."""
from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from rocket_sim_node import worlds
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import check
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.rocket import conditions

OWN = (
    'num_envs', 'seed', 'autoreset_mode', 'render_mode', 'simulators', 'patience', 'step_threads')
"""Keywords of the vector environment; all others are settings of the world."""
OWN_SINGLE = ('seed', 'render_mode', 'simulators', 'patience')
"""The same, of the single environment."""
RENDER_MODES = ('rgb_array',)


def check_names(world: str, given: Mapping[str, Any], own: tuple[str, ...] = OWN) -> None:
    """Check that all keywords are known.

    :param given: settings of the world by name, and whatever else was given.
    :param own: the environment's keywords, for the message.
    :raises ValueError: naming the unknown ones, those that look like them, and all expected ones.
    """
    known = [info.name for info in worlds.settings(world)]
    if has_conditions(world):
        known += ['conditions', *conditions.RANGES]
    unknown = sorted(set(given) - set(known))
    for name in unknown:
        if name in OWN:
            raise ValueError(
                f'{name}: got {given[name]!r:.80}, expected no such keyword of gymnasium.make, '
                'which makes one environment; it is a keyword of gymnasium.make_vec')
    if unknown:
        alike = difflib.get_close_matches(unknown[0], [*own, *known], 1)
        meant = f' (did you mean {alike[0]!r}?)' if alike else ''
        raise ValueError(
            f'unknown keyword {", ".join(map(repr, unknown))}{meant}, expected '
            f'{", ".join(own)}, or a setting of world {world!r}: {", ".join(known)}')


def has_conditions(world: str) -> bool:
    """Return whether a world draws conditions."""
    return set(conditions.FLAT_NAMES) <= {info.name for info in worlds.settings(world)}


def autoreset_mode(value: object) -> AutoresetMode:
    """Return the mode that an `AutoresetMode`, its name or its value denotes.

    :raises ValueError: for any but SAME_STEP and NEXT_STEP.
    """
    if isinstance(value, AutoresetMode | str):  # others, such as arrays, may not compare
        for mode in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP):
            if value in (mode, mode.name, mode.value):
                return mode
    raise ValueError(f'autoreset_mode: got {value!r:.80}, expected SAME_STEP or NEXT_STEP')


def check_number(name: str, value: object, expected: str = 'a number') -> None:
    """Check that an argument is a number.

    :raises TypeError: when it is none.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f'{name}: got {value!r:.80}, expected {expected}')


def check_connection(simulators: object, patience: Any, step_threads: object) -> None:
    """Check the keywords that concern simulators over DDS.

    :raises TypeError: for a wrong type.
    :raises ValueError: for a patience out of range, or threads together with simulators.
    """
    if not isinstance(simulators, str):
        raise TypeError(
            f"simulators: got {simulators!r:.80}, expected a string, such as '/sim_*'")
    check_number('patience', patience, 'a number of seconds')
    if not 0 < patience < math.inf:
        raise ValueError(f'patience: got {patience!r}, expected a finite number above 0, s')
    if simulators and step_threads != 1:
        raise ValueError(
            f'step_threads: got {step_threads!r}, expected 1 with simulators {simulators!r}: '
            'start them with this parameter instead')


def actions(value: Any, shape: tuple[int, ...] | None) -> NDArray[Any]:
    """Return actions as an array.

    :param shape: the expected one, for the message.
    :raises ValueError: when their parts differ in length.
    """
    try:
        return np.asarray(value)
    except ValueError as error:
        raise ValueError(
            f'action: got {" ".join(repr(value).split()):.80}, whose parts differ in length, '
            f'expected shape {shape}') from error


def reset_options(options: object) -> dict[str, Any]:
    """Return a copy of the options of a reset.

    :raises TypeError: when they are no dictionary.
    :raises ValueError: for `seed`, and for `reset_mask`, which is not supported.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping) or not all(isinstance(name, str) for name in options):
        raise TypeError(
            f"options: got {options!r:.80}, expected a dictionary, such as {{'level': 3}}")
    if 'seed' in options:
        raise ValueError("options: got 'seed', expected it as an argument of reset")
    if 'reset_mask' in options:
        raise ValueError(
            "options: got 'reset_mask', expected none: an ended episode is followed by the "
            'next one at once, and a single environment cannot be reset')
    return dict(options)


def check_render_mode(value: str | None, simulators: str) -> None:
    """Check `render_mode`.

    :raises ValueError: for an unknown one, or any over DDS.
    """
    if value is None:
        return
    if not isinstance(value, str) or value not in RENDER_MODES:
        raise ValueError(f'render_mode: got {value!r:.80}, expected None or {RENDER_MODES[0]!r}')
    if simulators:
        raise ValueError(
            f'render_mode: got {value!r}, expected None with simulators, which publish their '
            'states: watch them with the node rerun_recorder')


def check_values(world: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings, with conditions as numbers, after checking the values of known ones.

    :raises TypeError: for a value of a wrong type.
    :raises ValueError: for a value that is out of range.
    """
    flat = conditions.flatten(given) if has_conditions(world) else dict(given)
    for info in worlds.settings(world):
        if info.name in flat:
            check(info, flat[info.name])
    return flat


def split_settings(
    spec: WorldSpec, given: Mapping[str, Any], where: str,
) -> dict[str, Any]:
    """Return those settings that each reset is to repeat, after checking the others.

    A simulator has its settings already; a reset can change some of them.

    :param given: settings by name.
    :param where: the simulators, for messages.
    :raises TypeError: for a value of a wrong type.
    :raises ValueError: for a value that is out of range, or a setting that no reset can change,
        and that the simulators have at another value.
    """
    flat = check_values(spec.name, given)
    changeable = worlds.reset_settings(spec.name)
    infos = {info.name: info for info in worlds.settings(spec.name)}
    for name, value in flat.items():
        if name not in changeable and _described(infos[name], value) != spec.settings[name]:
            raise ValueError(
                f'{name}: got {value!r}, expected {spec.settings[name]:g}, the value of the '
                f'simulators {where}, or no argument')
    return {name: value for name, value in flat.items() if name in changeable}


def _described(info: SettingInfo, value: Any) -> float:
    """Return a checked value as descriptions of worlds have it: a choice is its index."""
    return float(info.choices.index(value) if info.choices else value)
