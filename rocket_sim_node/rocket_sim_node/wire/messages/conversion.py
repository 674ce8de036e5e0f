# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and arrays, without a Python loop over the elements.

rosidl stores a numeric sequence as an `array.array` and copies one in a single operation; a NumPy
array assigned to the same field is converted number by number, hundreds of times slower.
"""
from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rocket_msgs.msg import RocketState
from rocket_msgs.msg import Setting
from rocket_msgs.msg import World
from std_msgs.msg import Header

from rocket_sim_node import frames
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.quantities import QUANTITIES
from rocket_sim_node.telemetry.stamps import LATEST_TOLD
from rocket_sim_node.telemetry.stamps import NANOSECONDS
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec

MOST_ENVS = 16_384
"""Maximum number of rockets in one simulator. Their actions, 12 B each and not acknowledged within
a machine, fit into Linux's default socket buffer of 208 KiB. More rockets need more simulators."""
NO_UNITS: Mapping[str, str] = MappingProxyType({})
_MOST_NAMES = 4096
_MOST_CONDITIONS = 1024
_LEAST_DT, _MOST_DT = 1e-5, 60.0
_CODES = {'f4': 'f', 'f8': 'd', 'u1': 'B', 'u4': 'I', 'u8': 'Q', 'i4': 'i'}


def to_sequence(values: NDArray[Any], kind: str) -> array[Any]:
    """Return `values` flattened for a message field; `kind` is a NumPy type code."""
    return array(_CODES[kind], np.ascontiguousarray(values, dtype=kind).tobytes())


def from_sequence(sequence: array[Any], kind: str) -> NDArray[Any]:
    """Return a message field as a NumPy array that shares its memory."""
    return np.frombuffer(sequence, dtype=kind)


def time_of(stamp: int) -> Time:
    """Return a stamp in ns as a message."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=nanoseconds)


def stamp_of(message: Header) -> int:
    """Return the stamp of a simulator's message, ns.

    :raises ValueError: when no simulator sends it, naming the field.
    """
    stamp = message.stamp
    if not 0 <= stamp.sec * NANOSECONDS <= LATEST_TOLD:
        raise ValueError(
            f'header.stamp.sec: got {stamp.sec}, expected 0 to {LATEST_TOLD // NANOSECONDS}')
    if stamp.nanosec >= NANOSECONDS:
        raise ValueError(
            f'header.stamp.nanosec: got {stamp.nanosec}, expected 0 to {NANOSECONDS - 1}')
    return int(stamp.sec * NANOSECONDS + stamp.nanosec)


def header(stamp: int, frame: str) -> Header:
    """Return a header with a stamp in ns and the name of a frame."""
    return Header(stamp=time_of(stamp), frame_id=frame)


def settings_to_message(
    settings: Mapping[str, float], units: Mapping[str, str] = NO_UNITS,
) -> list[Setting]:
    """Return settings as messages.

    :param units: by name; '' where there is none.
    """
    return [
        Setting(name=name, value=float(value), unit=units.get(name, ''))
        for name, value in settings.items()]


def settings_from_message(
    settings: list[Setting], units: Mapping[str, str] = NO_UNITS,
) -> dict[str, float]:
    """Return settings by name.

    :param units: those that the settings have, by name. A setting without a unit has that one.
    :raises ValueError: when a name occurs twice, or a unit is another one.
    """
    for item in settings:
        expected = units.get(item.name, item.unit)
        if item.unit not in ('', expected):
            raise ValueError(
                f'settings: unit of {item.name!r}: got {item.unit!r}, expected {expected!r} '
                'or none')
    values = {item.name: item.value for item in settings}
    if len(values) != len(settings):
        raise ValueError(f'settings: a name is given twice in {[s.name for s in settings]}')
    return values


def world_to_message(
    spec: WorldSpec, session: int, step: int, mode: int,
    flown: Mapping[str, float] | None = None, answer: bytes = b'',
) -> World:
    """Return the description of a simulator.

    :param flown: all settings as they are flown; None: those of `spec`.
    :param answer: digest of the last answer of a service.
    """
    flown = dict(spec.settings if flown is None else flown)
    replaced = {name: own for name, own in spec.settings.items() if flown[name] != own}
    units = worlds.units(spec.name)
    return World(
        answer=to_sequence(np.frombuffer(answer, np.uint8), 'u1'),
        world=spec.name, session=session, step=step, mode=mode,
        num_envs=int(spec.num_envs), dt=float(spec.dt),
        observation_names=list(spec.observation_names),
        action_names=list(spec.action_names),
        action_kind=World.CONTINUOUS if spec.continuous else World.DISCRETE,
        action_low=list(spec.action_low), action_high=list(spec.action_high),
        action_idle=list(spec.action_idle), action_count=int(spec.action_count),
        outcomes=list(spec.outcomes), condition_names=list(spec.condition_names),
        settings=settings_to_message(flown, units),
        replaced=settings_to_message(replaced, units),
    )


def world_from_message(message: World) -> WorldSpec:
    """Return the shape of the world that a message describes.

    Its settings are the simulator's own, whatever the last reset replaced, so that a simulator
    remains the same to any agent.

    :raises ValueError: for an invalid description, naming field, value and expected value.
    """
    flown = settings_from_message(message.settings)
    replaced = settings_from_message(message.replaced)
    spec = WorldSpec(
        name=message.world, num_envs=message.num_envs, dt=message.dt,
        observation_names=tuple(message.observation_names),
        action_names=tuple(message.action_names),
        continuous=message.action_kind == World.CONTINUOUS,
        action_low=tuple(message.action_low), action_high=tuple(message.action_high),
        action_idle=tuple(message.action_idle), action_count=message.action_count,
        outcomes=tuple(message.outcomes), condition_names=tuple(message.condition_names),
        settings={**flown, **replaced},
    )
    for name, value, good, expected in _description_checks(message, spec):
        if not good:
            raise ValueError(f'world: {name}: got {value!r}, expected {expected}')
    return spec


def _description_checks(
    message: World, spec: WorldSpec,
) -> Iterator[tuple[str, object, bool, str]]:
    """Yield name, value, validity and expectation of each field of a world's description."""
    known = {item.name for item in message.settings}
    replaced = [item.name for item in message.replaced]
    yield 'replaced', replaced, known.issuperset(replaced), 'names of settings'
    yield 'num_envs', spec.num_envs, 1 <= spec.num_envs <= MOST_ENVS, f'1 to {MOST_ENVS}'
    yield 'dt', spec.dt, _LEAST_DT <= spec.dt <= _MOST_DT, f'{_LEAST_DT:g} to {_MOST_DT:g} s'
    yield 'mode', message.mode, message.mode in (World.LOCKSTEP, World.REALTIME), '0 or 1'
    for name, least, most in (
            ('observation_names', 1, _MOST_NAMES), ('action_names', 1, _MOST_NAMES),
            ('outcomes', 1, NO_OUTCOME), ('condition_names', 0, _MOST_CONDITIONS)):
        names = getattr(spec, name)
        yield (f'number of {name}', len(names), least <= len(names) <= most, f'{least} to {most}')
        yield name, names, len(set(names)) == len(names), 'each once'
    for name, words in (
            ('world', [spec.name]), ('observation_names', spec.observation_names),
            ('action_names', spec.action_names), ('outcomes', spec.outcomes),
            ('condition_names', spec.condition_names), ('settings', list(spec.settings))):
        # Names appear in logs and terminals.
        yield name, words, all(map(str.isprintable, words)), 'printable characters'
    yield ('action_kind', message.action_kind,
           message.action_kind in (World.CONTINUOUS, World.DISCRETE), '0 or 1')
    count = spec.action_size
    if not spec.continuous:
        yield ('action_count', spec.action_count, 1 <= spec.action_count < 2**31,
               f'1 to {2**31 - 1}')
        yield ('action_idle', spec.action_idle, len(spec.action_idle) == 1
               and spec.action_idle[0] in range(spec.action_count), 'one of the actions')
        return
    for name in ('action_low', 'action_high', 'action_idle'):
        values = getattr(spec, name)
        yield (name, values, len(values) == count and all(map(math.isfinite, values)),
               f'{count} finite numbers')
    yield ('action_low', spec.action_low, all(
        low < high for low, high in zip(spec.action_low, spec.action_high, strict=True)),
        f'each below action_high, {spec.action_high}')
    yield ('action_idle', spec.action_idle, all(
        low <= idle <= high for low, idle, high in zip(
            spec.action_low, spec.action_idle, spec.action_high, strict=True)),
        'each from action_low to action_high')


def action_from_message(message: Any, spec: WorldSpec) -> NDArray[Any]:
    """Return the actions in a message, `(N, A)` float32 or `(N,)` int32.

    :param message: of type Action, decoded (see `cdr`).

    :raises ValueError: when the kind or the number of values is not that of the world.
    """
    expected, other = ('continuous', 'discrete')[:: 1 if spec.continuous else -1]
    if len(getattr(message, other)):
        raise ValueError(
            f'{other}: {len(getattr(message, other))} values, expected none: '
            f'the actions of world {spec.name!r} are {expected}'
        )
    values: NDArray[Any] = getattr(message, expected)
    size = spec.num_envs * spec.action_size
    if len(values) != size:
        raise ValueError(
            f'{expected}: {len(values)} values, expected {size} '
            f'({spec.num_envs} rockets x {spec.action_size})'
        )
    return values.reshape(spec.num_envs, -1) if spec.continuous else values


_EPISODE_KINDS = {
    'row': np.int64, 'episode': np.int64, 'episode_return': np.float64, 'length': np.int64,
    'outcome': np.uint8, 'touchdown_speed': np.float64, 'tilt': np.float64,
    'distance': np.float64, 'fuel_used': np.float64, 'fuel_left': np.float64,
    'hover_time': np.float64, 'ignitions': np.int64, 'control_effort': np.float64,
}


def episode_arrays(episodes: Episodes) -> list[NDArray[Any]]:
    """Return finished episodes in the order of the message's fields."""
    return [getattr(episodes, name) for name in _EPISODE_KINDS]


def episodes_from_message(message: Any) -> Episodes:
    """Return finished episodes as arrays, with the same types as those of a world in process."""
    return Episodes(**{
        name: getattr(message, name).astype(dtype)
        for name, dtype in _EPISODE_KINDS.items()})


def state_to_message(
    step: NDArray[np.uint64], telemetry: Telemetry, session: int, stamp: int = 0,
) -> RocketState:
    """Return telemetry `(S,)` of steps `(S,)` as one message, converted to z up.

    :param stamp: simulated time of the newest sample, ns.
    """
    message = RocketState(
        header=header(stamp, frames.WORLD), session=session, step=to_sequence(step, 'u8'))
    for quantity in QUANTITIES:
        values = quantity.to_ros(telemetry.arrays[quantity.name])
        setattr(message, quantity.name, to_sequence(values, quantity.kind))
    return message
