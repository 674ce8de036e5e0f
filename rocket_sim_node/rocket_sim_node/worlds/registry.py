# SPDX-License-Identifier: Apache-2.0
"""Registry of worlds by name."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from functools import cache
from types import MappingProxyType
from typing import Any

from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.lunar import vehicle as lander
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld
from rocket_sim_node.worlds.planar.vehicle import PlanarSettings
from rocket_sim_node.worlds.planar.world import RocketPlanarWorld
from rocket_sim_node.worlds.rocket import spawn as rocket_starts
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings
from rocket_sim_node.worlds.rocket.world import RocketWorld


@dataclass(frozen=True)
class _Entry:
    world: Callable[..., SimulatedWorld]
    settings: type
    reset_settings: tuple[str, ...]
    threaded: bool = False
    derived: tuple[tuple[str, str], ...] = ()
    """Name and unit of the constants in the world's description that are no settings."""
    full_reach: Callable[[Mapping[str, float]], float] = rocket_starts.full_reach
    """Drop from the start to touchdown, m, of a world with such settings."""
    added: Mapping[str, float] = field(default_factory=dict)
    """Settings that older versions do not have, with the value at which nothing changes."""


_MOST_ENVS = 1_000_000


@dataclass(frozen=True)
class SteppingSettings:
    """How a world is stepped; results are the same, bit for bit, for any values."""

    step_threads: int = settings_module.setting(
        1, '', 'number of threads that step the world, for example one for each core that is '
        'free; lunar_lander only', 1, 256)


_STEPPING = settings_module.describe(SteppingSettings)
_STEP_THREADS = _STEPPING[0]

_WORLDS = {
    'rocket': _Entry(RocketWorld, RocketSettings, RocketWorld.reset_settings),
    'rocket_planar': _Entry(
        RocketPlanarWorld, PlanarSettings, RocketPlanarWorld.reset_settings),
    'lunar_lander': _Entry(
        LunarLanderWorld, LunarSettings, LunarLanderWorld.reset_settings, threaded=True,
        derived=(('field_half_width', 'm'), ('max_thrust', 'N')),
        full_reach=lambda settings: lander.DROP, added=LunarLanderWorld.added),
}


def names() -> tuple[str, ...]:
    """Return the names of all worlds."""
    return tuple(_WORLDS)


def _entry(name: str) -> _Entry:
    if name not in _WORLDS:
        raise ValueError(f'unknown world {name!r}, expected one of {", ".join(_WORLDS)}')
    return _WORLDS[name]


def settings(name: str) -> tuple[SettingInfo, ...]:
    """Return the settings of a world.

    :raises ValueError: for an unknown world.
    """
    return settings_module.describe(_entry(name).settings)


def stepping_settings(name: str) -> tuple[SettingInfo, ...]:
    """Return the settings of how a world is stepped; empty if it has none.

    :raises ValueError: for an unknown world.
    """
    return _STEPPING if _entry(name).threaded else ()


@cache
def units(name: str) -> Mapping[str, str]:
    """Return the units of the constants in a world's description, '' for those without one.

    A world that is not registered has none.
    """
    if name not in _WORLDS:
        return MappingProxyType({})
    return MappingProxyType({
        **{info.name: info.unit for info in settings(name)}, **dict(_WORLDS[name].derived)})


def settings_from(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of `values` that are settings of a world, in the types that `make` takes.

    A description on topic `world` also has values that are no settings, and encodes switches and
    choices as numbers, which this converts back. `make` validates the values.

    :raises ValueError: for an unknown world.
    """
    return {
        info.name: settings_module.from_number(info, values[info.name])
        for info in settings(name) if info.name in values}


def reset_settings(name: str) -> tuple[str, ...]:
    """Return the names of the settings that a reset may change.

    :raises ValueError: for an unknown world.
    """
    return _entry(name).reset_settings


def full_reach(spec: WorldSpec) -> float:
    """Return the largest `spawn_reach` of a world that has this setting, m: its full drop.

    :raises ValueError: for a world that is not registered and lacks settings of a rocket's.
    """
    known = _WORLDS.get(spec.name)
    try:
        return (known.full_reach if known else rocket_starts.full_reach)(spec.settings)
    except KeyError as error:
        raise ValueError(
            f'world {spec.name!r}: got no setting {error}, expected spawn_height and '
            'touchdown_height, or a full_reach in the registry of worlds') from error


def added_settings(name: str) -> dict[str, float]:
    """Return settings that older versions of a world do not have, with their value there.

    A world that is not registered has none.
    """
    return dict(_WORLDS[name].added) if name in _WORLDS else {}


def check_num_envs(num_envs: object) -> int:
    """Return a number of environments as an `int`; it may be an integer of NumPy.

    :raises ValueError: when it is not an integer from 1 to 1 000 000.
    """
    return settings_module.whole_number('num_envs', num_envs, 1, _MOST_ENVS)


def make(
    name: str, num_envs: int = 1, seed: int = 0, step_threads: int = 1, **values: Any,
) -> SimulatedWorld:
    """Create a world of `num_envs` rockets.

    :param name: one of `names()`.
    :param seed: seed of the random streams, 0 to 2**63 - 1.
    :param step_threads: threads that step the world, 1 to 256; more than 1 for `lunar_lander`
        only. The results are the same bits for any number.
    :param values: settings by name, the rest by default; see `settings(name)`. Worlds of rockets
        take conditions as `conditions.flatten` does.
    :raises ValueError: for an unknown world or setting, or a value out of range.
    """
    entry = _entry(name)
    num_envs, seed = check_num_envs(num_envs), random_streams.check_seed(seed)
    threads = settings_module.check(_STEP_THREADS, step_threads)
    if not entry.threaded and threads != 1:
        raise ValueError(
            f'step_threads: got {step_threads!r}, expected 1, as world {name!r} is stepped by '
            'one thread')
    if entry.threaded:
        values['step_threads'] = threads
    return entry.world(num_envs=num_envs, seed=seed, **values)
