# SPDX-License-Identifier: Apache-2.0
"""Conditions as settings: sets, names, ranges and what is drawn from them."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket.drawn_vehicle import draw
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

N = 4000
SPECIFIED: dict[str, dict[str, tuple[float, float]]] = {
    'nominal': {},
    'mix': {
        'dry_mass_factor': (0.95, 1.05), 'thrust_factor': (0.95, 1.05),
        'isp_factor': (0.97, 1.03), 'rcs_factor': (0.7, 1), 'engine_lag': (0, 0.2),
        'action_delay': (0, 3), 'side_acceleration': (0, 1)},
    'harsh': {
        'dry_mass_factor': (0.92, 1.08), 'thrust_factor': (0.92, 1.08),
        'isp_factor': (0.95, 1.05), 'rcs_factor': (0.5, 1.1), 'engine_lag': (0, 0.3),
        'action_delay': (0, 5), 'side_acceleration': (0, 1.5), 'gust_deviation': (0, 0.3),
        'sensor_noise': (0, 0.5), 'gravity_factor': (0.99, 1.01), 'fuel_factor': (0.9, 1)},
    'hoverslam': {'throttle_floor': (0.6, 0.6)},
}


def drawn(name: str, seed: int = 3, rows: int = N, episode: int = 0) -> dict[str, F64]:
    """Return what episodes of a set draw, by name."""
    settings = RocketSettings(**conditions.settings(name))  # type: ignore[arg-type]
    values = draw(seed, np.arange(rows), np.full(rows, episode), settings)
    return dict(zip(conditions.DRAWN_NAMES, values, strict=True))


@pytest.mark.parametrize('name', SPECIFIED)
def test_a_set_matches_the_specification(name: str) -> None:
    """And nominal in everything else."""
    flat = conditions.settings(name)
    assert set(flat) == set(conditions.FLAT_NAMES)
    for condition in conditions.RANGES:
        nominal = float(condition.endswith('factor'))
        expected = SPECIFIED[name].get(condition, (nominal, nominal))
        assert (flat[condition + '_low'], flat[condition + '_high']) == expected
    assert flat['ignitions'] == (name == 'hoverslam')
    assert tuple(SPECIFIED) == conditions.NAMES


@pytest.mark.parametrize('name', SPECIFIED)
def test_draws_fill_their_ranges(name: str) -> None:
    """Of 4 000 uniform draws the mean is within 5 standard errors of the middle."""
    for condition, values in drawn(name).items():
        if condition.endswith('direction'):
            low, high = 0.0, 2 * np.pi
        else:
            nominal = float(condition.endswith('factor'))
            low, high = SPECIFIED[name].get(condition, (nominal, nominal))
        assert values.min() >= low
        assert values.max() <= high
        if low == high:
            continue
        if condition == 'action_delay':
            share = np.bincount(values.astype(int), minlength=int(high) + 1) / N
            assert len(share) == high + 1
            assert np.abs(share - 1 / len(share)).max() < 5 * np.sqrt(0.25 / N)
            assert np.array_equal(values, np.floor(values))
            continue
        assert abs(values.mean() - (low + high) / 2) < 5 * (high - low) / np.sqrt(12 * N)
        assert values.std() == pytest.approx((high - low) / np.sqrt(12), rel=0.05)


@pytest.mark.parametrize('name', ['mix', 'harsh'])
def test_a_share_stays_nominal(name: str) -> None:
    """The others fill the ranges as before; directions are always drawn."""
    values = conditions.settings(name)
    settings = RocketSettings(**{**values, 'nominal_share': 0.4})  # type: ignore[arg-type]
    found = draw(3, np.arange(N), np.zeros(N, int), settings)
    kept = found == conditions.NOMINAL[:, None]
    for row, condition in enumerate(conditions.DRAWN_NAMES):
        if condition.endswith('direction'):
            assert not kept[row].any()
            continue
        low, high = values[condition + '_low'], values[condition + '_high']
        if low == high:
            assert kept[row].all()
            continue
        values_of_a_delay = high - low + 1 if condition == 'action_delay' else np.inf
        assert kept[row].mean() == pytest.approx(0.4 + 0.6 / values_of_a_delay, abs=0.04)
        drawn_values = found[row, ~kept[row]]
        span = 0.01 * (high - low)
        assert low <= drawn_values.min() <= max(low + span, 1.0)
        assert high - span <= drawn_values.max() <= high
    together = np.corrcoef(kept[:4].astype(float))
    assert np.abs(together - np.eye(4)).max() < 0.08


def test_conditions_are_drawn_independently() -> None:
    """Correlations of 4 000 pairs are below 5 standard errors."""
    values = np.array([v for v in drawn('harsh').values() if v.std()])
    off = np.abs(np.corrcoef(values) - np.eye(len(values)))
    assert off.max() < 5 / np.sqrt(N)


def test_the_page_about_worlds_lists_the_same_values() -> None:
    """Its table, condition by condition."""
    page = (Path(__file__).parents[6] / 'docs' / 'reference' / 'worlds.md').read_text()
    assert '| condition | nominal | mix | harsh | hoverslam |' in page
    for condition in (*conditions.RANGES, 'ignitions'):
        line = next(line for line in page.splitlines() if line.startswith(f'| `{condition}`'))
        for cell, name in zip(line.split('|')[2:6], conditions.NAMES, strict=True):
            flat = conditions.settings(name)
            low, high = (
                flat.get(condition + end, flat.get(condition)) for end in ('_low', '_high'))
            assert cell.strip() == (f'{low:g}' if low == high else f'{low:g} to {high:g}')


def test_draws_are_a_function_of_seed_row_and_episode() -> None:
    """They do not depend on other rows or other conditions."""
    one, same = drawn('harsh'), drawn('harsh', rows=7)
    assert all(np.array_equal(one[name][:7], same[name]) for name in one)
    for other in (drawn('harsh', seed=4), drawn('harsh', episode=1)):
        assert (one['dry_mass_factor'] != other['dry_mass_factor']).all()
    mix = drawn('mix')
    assert np.allclose(
        (one['dry_mass_factor'] - 1) / 0.08, (mix['dry_mass_factor'] - 1) / 0.05, atol=1e-12)


def test_the_table_of_single_conditions() -> None:
    """The 26 of the evaluation, each with all settings, each its own."""
    table = conditions.SINGLE
    assert len(table) == 26
    for flat in table.values():
        assert set(flat) == set(conditions.FLAT_NAMES)
    assert len({tuple(flat.values()) for flat in table.values()}) == 26
    changed = {
        label: {name: value for name, value in flat.items()
                if value != table['nominal'][name]} for label, flat in table.items()}
    assert changed['mass -5 %'] == {'dry_mass_factor_low': 0.95, 'dry_mass_factor_high': 0.95}
    assert changed['throttle from 40 %, no relight'] == {
        'throttle_floor_low': 0.4, 'throttle_floor_high': 0.4, 'ignitions': 1}
    assert changed['delay 3 steps'] == {'action_delay_low': 3, 'action_delay_high': 3}
    assert table['harsh'] == conditions.settings('harsh')
    assert conditions.name_of(table['throttle from 60 %, no relight']) == 'hoverslam'


def test_flatten_takes_a_number_a_pair_and_a_set() -> None:
    """The more specific value wins; other settings are passed through."""
    assert conditions.flatten({'dry_mass_factor': 1.05, 'level': 8}) == {
        'dry_mass_factor_low': 1.05, 'dry_mass_factor_high': 1.05, 'level': 8}
    assert conditions.flatten({'engine_lag': (0, 0.2), 'engine_lag_high': 0.1}) == {
        'engine_lag_low': 0, 'engine_lag_high': 0.1}
    assert conditions.flatten({'conditions': 'mix', 'rcs_factor': [0.5, 0.6]}) == {
        **conditions.settings('mix'), 'rcs_factor_low': 0.5, 'rcs_factor_high': 0.6}
    with pytest.raises(ValueError, match=r'engine_lag: got \(1, 2, 3\), expected a number or'):
        conditions.flatten({'engine_lag': (1, 2, 3)})


def test_sets_are_recognised_by_their_settings() -> None:
    """From the settings of a world, too."""
    for name in conditions.NAMES:
        assert conditions.name_of(conditions.settings(name)) == name
        for world in ('rocket', 'rocket_planar'):
            assert conditions.name_of(worlds.make(world, conditions=name).spec.settings) == name
    assert conditions.name_of({}) == 'nominal'
    assert conditions.name_of({'engine_lag_high': 0.1}) == 'custom'
    with pytest.raises(ValueError, match="conditions: got 'mild', expected one of nominal, mix"):
        conditions.settings('mild')


@pytest.mark.parametrize(('values', 'message'), [
    ({'engine_lag': (0.2, 0.1)},
     "'engine_lag_low': got 0.2, expected at most 'engine_lag_high', 0.1"),
    ({'thrust_factor_low': 1.1}, "'thrust_factor_low': got 1.1, .*'thrust_factor_high', 1"),
    ({'dry_mass_factor': 0.0}, 'dry_mass_factor_low: got 0.0, expected 0.1 to 10'),
    ({'action_delay': 1.5}, 'action_delay_low: got 1.5, expected a whole number'),
    ({'action_delay': 51}, 'action_delay_low: got 51, expected 0 to 50 steps'),
    ({'ignitions': -1}, 'ignitions: got -1, expected 0 to 1000'),
    ({'conditions': 'mild'}, "conditions: got 'mild'"),
])
def test_invalid_conditions_are_refused(values: dict[str, Any], message: str) -> None:
    """By name, when a world is made and when it is reset, which changes nothing."""
    with pytest.raises((ValueError, TypeError), match=message):
        worlds.make('rocket', **values)
    world = worlds.make('rocket', 3)
    before = world.snapshot()
    with pytest.raises((ValueError, TypeError), match=message):
        world.reset(**values)
    assert world.snapshot() == before


def test_a_reset_puts_conditions_into_force_until_the_next() -> None:
    """On top of those the world was made with; a set replaces all of them."""
    world = worlds.make('rocket', 200, dry_mass_factor=1.2)

    def masses() -> F64:
        return world.telemetry(slice(None)).mass / 24_000

    heavy = (22_000 * 1.2 + 2_000) / 24_000
    assert np.allclose(masses(), heavy)
    world.reset(conditions='mix')
    assert masses().std() > 0.02
    world.reset(fuel_factor=0.5)
    assert np.allclose(masses(), (22_000 * 1.2 + 1_000) / 24_000)
    world.reset(**conditions.settings('nominal'))
    assert np.allclose(masses(), 1)
    world.reset()
    assert np.allclose(masses(), heavy)


def test_telemetry_holds_the_drawn_conditions() -> None:
    """By name, as `draw` has it; nominal values where nothing is drawn, none for landers."""
    world = worlds.make('rocket', 5, seed=3, conditions='harsh')
    held = world.telemetry(np.array([1, 4])).conditions
    expected = np.array(list(drawn('harsh', rows=5).values())).T[[1, 4]]
    assert np.array_equal(held, expected)
    nominal = worlds.make('rocket_planar', 2).telemetry(slice(None)).conditions
    assert nominal.tolist() == [[
        float(name.endswith('factor')) for name in conditions.DRAWN_NAMES]] * 2
    assert worlds.make('lunar_lander', 2).telemetry(slice(None)).conditions.shape == (2, 0)
