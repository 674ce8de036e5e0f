# SPDX-License-Identifier: Apache-2.0
"""Conditions: deviations of a flight from the nominal one, as settings and as named sets.

Each condition is a range, two settings `<name>_low` and `<name>_high`. An episode draws a value
from it, uniformly and independently of the others, unless it keeps the nominal value, with
probability `nominal_share`; see :func:`drawn_vehicle.draw`.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import fields
from typing import Any
from typing import cast

import numpy as np

from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import WorldSpec

LOW, HIGH = '_low', '_high'


def _range(nominal: float, unit: str, what: str, low: float, high: float, end: str) -> Any:
    return setting(nominal, unit, f'{what}; {end} end of the range drawn from', low, high)


def _low(nominal: float, unit: str, what: str, low: float, high: float) -> Any:
    return _range(nominal, unit, what, low, high, 'low')


def _high(nominal: float, unit: str, what: str, low: float, high: float) -> Any:
    return _range(nominal, unit, what, low, high, 'high')


_DRY_MASS = 1.0, '', 'dry mass, factor', 0.1, 10.0
_THRUST = 1.0, '', 'maximum thrust, factor', 0.0, 10.0
_ISP = 1.0, '', 'specific impulse, factor', 0.1, 10.0
_RCS = 1.0, '', 'RCS torque, factor', 0.0, 10.0
_LAG = 0.0, 's', 'time constant of the engine, first order', 0.0, 10.0
_DELAY = 0, 'steps', 'delay of actions', 0, 50
_SIDE = 0.0, 'm/s^2', 'side acceleration, horizontal, in any direction', 0.0, 100.0
_GUSTS = 0.0, 'm/s^2', 'gusts, deviation of each horizontal component', 0.0, 100.0
_NOISE = 0.0, '', 'sensor noise, in units of 0.5 m, 0.2 m/s and 1 deg', 0.0, 100.0
_GRAVITY = 1.0, '', 'gravity, factor', 0.0, 10.0
_FUEL = 1.0, '', 'fuel at spawn, factor', 0.0, 10.0
_AIR = 1.0, '', 'density of the air, factor', 0.0, 10.0
_FLOOR = 0.0, '', 'least throttle of a burning engine', 0.0, 1.0
_WIND = 0.0, 'm/s', 'steady wind, horizontal, in any direction', 0.0, 100.0


@dataclass(frozen=True)
class ConditionSettings:
    """Ranges that each episode draws from; nominal by default."""

    dry_mass_factor_low: float = _low(*_DRY_MASS)
    dry_mass_factor_high: float = _high(*_DRY_MASS)
    thrust_factor_low: float = _low(*_THRUST)
    thrust_factor_high: float = _high(*_THRUST)
    isp_factor_low: float = _low(*_ISP)
    isp_factor_high: float = _high(*_ISP)
    rcs_factor_low: float = _low(*_RCS)
    rcs_factor_high: float = _high(*_RCS)
    engine_lag_low: float = _low(*_LAG)
    engine_lag_high: float = _high(*_LAG)
    action_delay_low: int = _low(*_DELAY)
    action_delay_high: int = _high(*_DELAY)
    side_acceleration_low: float = _low(*_SIDE)
    side_acceleration_high: float = _high(*_SIDE)
    gust_deviation_low: float = _low(*_GUSTS)
    gust_deviation_high: float = _high(*_GUSTS)
    sensor_noise_low: float = _low(*_NOISE)
    sensor_noise_high: float = _high(*_NOISE)
    gravity_factor_low: float = _low(*_GRAVITY)
    gravity_factor_high: float = _high(*_GRAVITY)
    fuel_factor_low: float = _low(*_FUEL)
    fuel_factor_high: float = _high(*_FUEL)
    air_density_factor_low: float = _low(*_AIR)
    air_density_factor_high: float = _high(*_AIR)
    throttle_floor_low: float = _low(*_FLOOR)
    throttle_floor_high: float = _high(*_FLOOR)
    wind_speed_low: float = _low(*_WIND)
    wind_speed_high: float = _high(*_WIND)
    ignitions: int = setting(0, '', 'maximum number of ignitions; 0: any number', 0, 1000)
    nominal_share: float = setting(
        0.0, '', 'probability that an episode leaves a condition nominal instead of drawing it, '
        'independently for each', 0.0, 0.99)

    def __post_init__(self) -> None:
        """Check the ranges.

        :raises ValueError: when the upper end of one is below its lower end.
        """
        for name in RANGES:
            low, high = getattr(self, name + LOW), getattr(self, name + HIGH)
            if low > high:
                raise ValueError(
                    f"setting '{name}{LOW}': got {low:g}, "
                    f"expected at most '{name}{HIGH}', {high:g}")

    def drawn_range(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a condition that an episode may have."""
        low, high = getattr(self, name + LOW), getattr(self, name + HIGH)
        if not self.nominal_share:
            return low, high
        nominal = _NOMINAL[name + LOW]
        return min(low, nominal), max(high, nominal)


_NOMINAL = {field.name: float(cast(float, field.default)) for field in fields(ConditionSettings)}
NOMINAL = np.array([
    *(_NOMINAL[name] for name in _NOMINAL if name.endswith(LOW)), 0.0, 0.0])
"""Nominal values `(C,)` in the order of `DRAWN_NAMES`."""
FLAT_NAMES = tuple(_NOMINAL)
"""Names of all condition settings."""
RANGES = tuple(name.removesuffix(LOW) for name in FLAT_NAMES if name.endswith(LOW))
"""Names of the conditions that are ranges."""
DRAWN_NAMES = (*RANGES, 'side_direction', 'wind_direction')
"""Names of the values drawn for an episode, in order; directions in rad from x towards z."""


def flatten(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return single settings from a mapping that may also name sets and conditions.

    `conditions` expands to all settings of a set; the name of a condition to both ends of its
    range, given as one number or a pair (low, high). Other names are passed through, and the
    more specific name takes precedence.

    >>> flatten({'engine_lag': (0.0, 0.2), 'level': 7})
    {'engine_lag_low': 0.0, 'engine_lag_high': 0.2, 'level': 7}

    :raises ValueError: for an unknown set, or a sequence that is not a pair.
    """
    flat: dict[str, Any] = settings(values['conditions']) if 'conditions' in values else {}
    for name in RANGES:
        if name not in values:
            continue
        value = values[name]
        pair = tuple(value) if isinstance(value, tuple | list) else (value, value)
        if len(pair) != 2:
            raise ValueError(f'{name}: got {value!r}, expected a number or a pair (low, high)')
        flat[name + LOW], flat[name + HIGH] = pair
    return {**flat, **{
        name: value for name, value in values.items()
        if name != 'conditions' and name not in RANGES}}


def _set(**values: float | tuple[float, float]) -> dict[str, float]:
    """Return all condition settings, nominal except for the given ones."""
    return {**_NOMINAL, **{name: float(value) for name, value in flatten(values).items()}}


_SETS = {
    'nominal': _set(),
    'mix': _set(
        dry_mass_factor=(0.95, 1.05), thrust_factor=(0.95, 1.05), isp_factor=(0.97, 1.03),
        rcs_factor=(0.7, 1.0), engine_lag=(0.0, 0.2), action_delay=(0, 3),
        side_acceleration=(0.0, 1.0)),
    'harsh': _set(
        dry_mass_factor=(0.92, 1.08), thrust_factor=(0.92, 1.08), isp_factor=(0.95, 1.05),
        rcs_factor=(0.5, 1.1), engine_lag=(0.0, 0.3), action_delay=(0, 5),
        side_acceleration=(0.0, 1.5), gust_deviation=(0.0, 0.3), sensor_noise=(0.0, 0.5),
        gravity_factor=(0.99, 1.01), fuel_factor=(0.9, 1.0)),
    'hoverslam': _set(throttle_floor=0.6, ignitions=1),
}
NAMES = tuple(_SETS)
"""Names of the sets."""

SINGLE = {
    'nominal': _set(),
    'mass +5 %': _set(dry_mass_factor=1.05),
    'mass -5 %': _set(dry_mass_factor=0.95),
    'thrust +5 %': _set(thrust_factor=1.05),
    'thrust -5 %': _set(thrust_factor=0.95),
    'Isp -3 %': _set(isp_factor=0.97),
    'gravity +2 %': _set(gravity_factor=1.02),
    'gravity -2 %': _set(gravity_factor=0.98),
    'air density x 1.5': _set(air_density_factor=1.5),
    'RCS x 0.7': _set(rcs_factor=0.7),
    'fuel -10 %': _set(fuel_factor=0.9),
    'delay 1 step': _set(action_delay=1),
    'delay 2 steps': _set(action_delay=2),
    'delay 3 steps': _set(action_delay=3),
    'lag 0.1 s': _set(engine_lag=0.1),
    'lag 0.2 s': _set(engine_lag=0.2),
    'side 0.5 m/s^2': _set(side_acceleration=0.5),
    'side 1 m/s^2': _set(side_acceleration=1.0),
    'noise x 0.25': _set(sensor_noise=0.25),
    'noise x 1': _set(sensor_noise=1.0),
    'throttle from 40 %': _set(throttle_floor=0.4),
    'throttle from 40 %, no relight': _set(throttle_floor=0.4, ignitions=1),
    'throttle from 60 %, no relight': _set(throttle_floor=0.6, ignitions=1),
    'mass +5 %, thrust -5 %': _set(dry_mass_factor=1.05, thrust_factor=0.95),
    'mix': _SETS['mix'],
    'harsh': _SETS['harsh'],
}
"""Conditions of the evaluation's table, by label: all condition settings of each."""


def settings(name: str) -> dict[str, float]:
    """Return all condition settings of a set.

    :raises ValueError: for an unknown name.
    """
    if not isinstance(name, str) or name not in NAMES:
        raise ValueError(f'conditions: got {name!r:.200}, expected one of {", ".join(NAMES)}')
    return dict(_SETS[name])


def check_world(spec: WorldSpec, asked: object, name: str = 'conditions') -> None:
    """Check that a world has conditions, if any are requested.

    :param asked: the requested conditions.
    :param name: name of the requesting setting.
    :raises ValueError: when the world has none; names setting and world.
    """
    if not set(FLAT_NAMES) <= set(spec.settings):
        raise ValueError(
            f'{name}: got {asked!r:.200}, expected none, as world {spec.name!r} has no conditions')


def name_of(values: Mapping[str, Any]) -> str:
    """Return the name of the set that equals these settings, 'custom' if none does.

    :param values: settings by name; missing conditions are nominal, other settings ignored.
    """
    found = {name: values.get(name, nominal) for name, nominal in _NOMINAL.items()}
    return next((name for name in NAMES if _SETS[name] == found), 'custom')
