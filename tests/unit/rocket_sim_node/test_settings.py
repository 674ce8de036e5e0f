# SPDX-License-Identifier: Apache-2.0
"""Settings have a unit, a range and a description; errors name the bad value."""
from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import pytest

from rocket_sim_node import settings
from rocket_sim_node import worlds
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

INFOS = [info for info in worlds.settings('rocket') if not info.choices]
UNITLESS = {
    'substeps', 'throttle_cutoff', 'drag_coefficient', 'level', 'observation_limit',
    'reward_step', 'reward_crash', 'reward_landed', 'reward_speed', 'reward_tilt',
    'reward_distance', 'ignitions', 'nominal_share', 'spawn_copies',
    *(name + end for end in ('_low', '_high') for name in (
        'dry_mass_factor', 'thrust_factor', 'isp_factor', 'rcs_factor', 'sensor_noise',
        'gravity_factor', 'fuel_factor', 'air_density_factor', 'throttle_floor')),
}
SPECIFIED = {
    'dt': 0.02, 'dry_mass': 22_000, 'fuel': 2_000, 'max_thrust': 470_880,
    'specific_impulse': 282, 'gravity': 9.81, 'throttle_cutoff': 0.01, 'rcs_torque': 2e6,
    'inertia': 5e5, 'yaw_damping': 0.05, 'air_density': 1.225, 'drag_coefficient': 0.30,
    'drag_area': 10.8, 'spawn_height': 200, 'touchdown_height': 5.2, 'landed_speed': 3,
    'landed_tilt': 10, 'landed_distance': 15, 'tilt_limit': 45, 'time_limit': 30,
    'height_limit': 400, 'range_limit': 200, 'reward_step': -0.01, 'reward_crash': -100,
    'reward_landed': 100, 'reward_speed': 100, 'reward_tilt': 50, 'reward_distance': 50,
    'position_scale': 50, 'velocity_scale': 20, 'spin_scale': 10, 'observation_limit': 5,
}


@dataclass(frozen=True)
class Sample:
    """One setting of each kind."""

    ratio: float = settings.setting(0.5, 'm', 'a number', 0.0, 2.0)
    count: int = settings.setting(3, '', 'a whole number', 1, 9)
    fast: bool = settings.setting(False, '', 'a flag')
    mode: str = settings.setting('slow', '', 'a word', choices=('slow', 'swift'))
    sizes: tuple[int, ...] = settings.setting((64, 32), '', 'a list', 1, 512)
    seed: int = settings.setting(0, '', 'a large whole number', 0, 2**62)


def test_defaults_are_the_numbers_of_the_specification() -> None:
    """And thrust to weight at spawn is two."""
    values = settings.as_dict(RocketSettings())
    assert {name: values[name] for name in SPECIFIED} == SPECIFIED
    weight = (values['dry_mass'] + values['fuel']) * values['gravity']
    assert values['max_thrust'] / weight == pytest.approx(2, abs=1e-12)


@pytest.mark.parametrize('info', INFOS, ids=lambda info: info.name)
def test_every_setting_of_the_rocket_is_described(info: SettingInfo) -> None:
    """Unit, description and a finite range that holds the default."""
    assert info.description
    assert bool(info.unit) == (info.name not in UNITLESS)
    assert math.isfinite(info.low)
    assert math.isfinite(info.high)
    assert isinstance(info.default, int | float)
    assert info.low <= info.default <= info.high


@pytest.mark.parametrize('info', INFOS, ids=lambda info: info.name)
def test_default_is_of_the_kind_of_its_field(info: SettingInfo) -> None:
    """The kind of a setting is that of its default: a number like 2.5 must not be refused."""
    kinds = {field.name: field.type for field in dataclasses.fields(RocketSettings)}
    assert type(info.default).__name__ == kinds[info.name]


@pytest.mark.parametrize('info', INFOS, ids=lambda info: info.name)
def test_out_of_range_names_setting_value_and_range(info: SettingInfo) -> None:
    """Just outside either end, and what is not finite."""
    step = 1 if isinstance(info.default, int) else (info.high - info.low) * 1e-6
    for value in (info.low - step, info.high + step, math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=f'^{info.name}: got') as error:
            settings.build(RocketSettings, {info.name: value})
        assert repr(value) in str(error.value)
        assert f'{info.low:g} to {info.high:g}' in str(error.value)
        assert info.unit in str(error.value)


@pytest.mark.parametrize('info', INFOS, ids=lambda info: info.name)
def test_the_ends_of_a_range_are_in_it(info: SettingInfo) -> None:
    """Ranges are inclusive."""
    for value in (info.low, info.high):
        assert settings.check(info, value) == value


def test_unknown_settings_are_named_with_the_known_ones() -> None:
    """A misspelt name is an error, not a default."""
    with pytest.raises(ValueError, match=r"unknown setting 'altitude', 'gravty'.*spawn_height"):
        worlds.make('rocket', gravty=9.0, altitude=3.0, dt=0.02)
    with pytest.raises(ValueError, match="unknown world 'rokcet', expected one of rocket"):
        worlds.make('rokcet')
    with pytest.raises(ValueError, match="unknown world 'rokcet'"):
        worlds.settings('rokcet')


@pytest.mark.parametrize(('name', 'value', 'expected'), [
    ('ratio', 2, 2.0), ('count', 4.0, 4), ('fast', True, True), ('mode', 'swift', 'swift'),
    ('sizes', [1, 512], (1, 512)), ('sizes', (), ()), ('seed', 2**53 + 1, 2**53 + 1),
    ('ratio', np.array(2), 2.0), ('sizes', np.array([1, 512]), (1, 512)),
])
def test_good_values_become_the_kind_of_the_default(
    name: str, value: object, expected: object,
) -> None:
    """A whole float will do for a whole number, and a list for a tuple."""
    got = getattr(settings.build(Sample, {name: value}), name)
    assert got == expected
    assert type(got) is type(expected)


@pytest.mark.parametrize(('name', 'value', 'message'), [
    ('ratio', True, 'ratio: got True, expected a number'),
    ('ratio', '1', "ratio: got '1', expected a number"),
    ('ratio', None, 'ratio: got None, expected a number'),
    ('count', 2.5, 'count: got 2.5, expected a whole number'),
    ('fast', 1, 'fast: got 1, expected true or false'),
    ('mode', 3, 'mode: got 3, expected a string'),
    ('sizes', '12', "sizes: got '12', expected a list of whole numbers"),
    ('sizes', 12, 'sizes: got 12, expected a list of whole numbers'),
    ('sizes', [1.5], 'sizes: got 1.5, expected a whole number'),
    ('sizes', np.array(12), 'sizes: got array(12), expected a list of whole numbers'),
    ('sizes', np.ones((1, 2), int), 'sizes: got array([1, 1]), expected a number'),
    ('ratio', np.array([1, 2]), 'ratio: got array([1, 2]), expected a number'),
    ('ratio', np.ones((2, 1)), 'ratio: got array([[1.], [1.]]), expected a number'),
    ('count', np.array([4]), 'count: got array([4]), expected a number'),
    ('fast', np.array([True]), 'fast: got array([ True]), expected true or false'),
])
def test_another_kind_is_a_type_error(name: str, value: object, message: str) -> None:
    """Named with the value and what was expected."""
    with pytest.raises(TypeError) as error:
        settings.build(Sample, {name: value})
    assert str(error.value) == message


@pytest.mark.parametrize(('name', 'value', 'message'), [
    ('ratio', 2.1, 'ratio: got 2.1, expected 0 to 2 m'),
    ('count', 10, 'count: got 10, expected 1 to 9'),
    ('seed', 2**62 + 1, 'seed: got 4611686018427387905, expected 0 to 4.61169e+18'),
    ('ratio', math.inf, 'ratio: got inf, expected 0 to 2 m'),
    ('mode', 'quick', "mode: got 'quick', expected one of slow, swift"),
    ('sizes', [64, 0], 'sizes: got 0, expected 1 to 512'),
])
def test_out_of_range_is_a_value_error(name: str, value: object, message: str) -> None:
    """No trailing blank where there is no unit."""
    with pytest.raises(ValueError, match='expected') as error:
        settings.build(Sample, {name: value})
    assert str(error.value) == message


def test_settings_are_frozen_and_go_round() -> None:
    """As a dictionary and back."""
    made = settings.build(Sample, {'ratio': 1.5, 'sizes': [8]})
    assert settings.build(Sample, settings.as_dict(made)) == made
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.ratio = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'num_envs': 0}, 'num_envs: got 0'), ({'num_envs': 2.0}, 'num_envs: got 2.0'),
    ({'num_envs': 1_000_001}, '1 to 1000000'), ({'seed': -1}, 'seed: got -1'),
    ({'seed': 2**63}, 'from 0 to 2'), ({'seed': 1.5}, 'seed: got 1.5'),
])
def test_size_and_seed_are_checked(arguments: dict[str, int], message: str) -> None:
    """Before anything is allocated."""
    with pytest.raises(ValueError, match=message):
        worlds.make('rocket', **arguments)
