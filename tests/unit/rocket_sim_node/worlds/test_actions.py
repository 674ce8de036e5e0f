# SPDX-License-Identifier: Apache-2.0
"""Actions are clipped where they may be and refused by name where they may not."""
from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from rocket_sim_node import worlds
from rocket_sim_node.worlds.actions import checked_action

SPEC = worlds.make('rocket', num_envs=2).spec
DISCRETE = dataclasses.replace(SPEC, continuous=False, action_count=4)
GOOD = [[-1.0, 0.0, 1.0], [0.25, -0.5, 0.75]]


@pytest.mark.parametrize('kind', [np.float16, np.float32, np.float64, np.int8, np.uint64])
def test_all_kinds_of_numbers_become_float64(kind: type[Any]) -> None:
    """Whole numbers fly too."""
    given = np.array([[1, 0, 1], [0, 1, 0]], kind)
    got = checked_action(SPEC, given)
    assert got.dtype == np.float64
    assert got.tolist() == given.tolist()


def test_values_within_bounds_are_kept_to_the_bit() -> None:
    """float32 widens without change, and the caller's array is not written to."""
    given = np.array(GOOD, np.float32) * np.float32(0.9)
    before = given.copy()
    got = checked_action(SPEC, given)
    assert np.array_equal(got, given.astype(np.float64))
    got[:] = 7
    assert np.array_equal(given, before)


def test_values_out_of_bounds_are_clipped() -> None:
    """Up to the largest float and the largest whole number."""
    huge = np.finfo(np.float64).max
    got = checked_action(SPEC, np.array([[-huge, huge, 1.0001], [-2.0, 5.0, -1.0]]))
    assert got.tolist() == [[-1, 1, 1], [-1, 1, -1]]
    assert checked_action(SPEC, np.full((2, 3), 2**63 - 1)).tolist() == [[1] * 3] * 2
    assert checked_action(SPEC, np.full((2, 3), -(2**63))).tolist() == [[-1] * 3] * 2


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(('row', 'column', 'name'), [(0, 0, 'throttle'), (1, 2, 'rcs_z')])
def test_values_that_are_not_finite_are_refused_by_row_and_name(
    value: float, row: int, column: int, name: str,
) -> None:
    """Infinity is not clipped to a bound: it is never flown."""
    action = np.array(GOOD, np.float32)
    action[row, column] = value
    with pytest.raises(ValueError, match=rf"row {row}, '{name}' is {value}"):
        checked_action(SPEC, action)


@pytest.mark.parametrize('action', [
    np.zeros(3), np.zeros((2, 2)), np.zeros((3, 2)), np.zeros((1, 3)), np.zeros((2, 3, 1)),
    np.zeros((0, 3)), np.zeros((2, 3), bool), np.zeros((2, 3), complex),
    np.full((2, 3), 'a'), np.full((2, 3), None),
], ids=lambda a: f'{a.dtype}-{a.shape}')
def test_another_shape_or_kind_is_refused(action: np.ndarray[Any, Any]) -> None:
    """The message says what was expected."""
    with pytest.raises(ValueError, match=r'expected numbers of shape \(2, 3\)'):
        checked_action(SPEC, action)


def test_discrete_actions_are_whole_numbers_below_the_count() -> None:
    """Nothing is clipped: a choice that does not exist is an error."""
    got = checked_action(DISCRETE, np.array([0, 3], np.uint8))
    assert got.dtype == np.int64
    assert got.tolist() == [0, 3]
    for row, bad in ((1, [0, 4]), (0, [-1, 0])):
        with pytest.raises(ValueError, match=f'row {row} is {bad[row]}, expected 0 to 3'):
            checked_action(DISCRETE, np.array(bad))
    for wrong in (np.zeros(2), np.zeros((2, 1), int), np.zeros(2, bool), np.zeros(3, int)):
        with pytest.raises(ValueError, match=r'expected whole numbers of shape \(2,\)'):
            checked_action(DISCRETE, wrong)


@pytest.mark.parametrize('name', worlds.names())
def test_a_checked_step_is_a_step(name: str) -> None:
    one, other = (worlds.make(name, num_envs=3, seed=1) for _ in range(2))
    spec = one.spec
    given: Any = (
        np.full((3, spec.action_size), 2.0) if spec.continuous else np.array([0, 2, 1]))
    one.step(given)
    other.step_checked(checked_action(spec, given))
    assert one.snapshot() == other.snapshot()


@pytest.mark.parametrize(('name', 'settings', 'steps'), [
    ('rocket', {}, 3), ('lunar_lander', {}, 3), ('rocket_planar', {'spawn_heading': 180.0}, 3),
    ('rocket_planar', {'spawn_reach': 1.0, 'engine_cutoff': True}, 80)])
def test_a_step_leaves_the_action_as_it_is(
        name: str, settings: dict[str, Any], steps: int) -> None:
    # In real time, the simulator flies the last action until the next one arrives.
    world = worlds.make(name, num_envs=3, seed=1, **settings)
    spec = world.spec
    action = checked_action(spec, (
        np.full((3, spec.action_size), 0.5) if spec.continuous else np.array([0, 2, 1])))
    given = action.copy()
    for _ in range(steps):
        world.step_checked(action)
        assert np.array_equal(action, given)
