# SPDX-License-Identifier: Apache-2.0
"""Names, filters and states of rockets as entities."""
from __future__ import annotations

import signal
import time

import numpy as np
import pytest

from rocket_sim_node import worlds
from rocket_sim_node.standard_views import entities


@pytest.mark.parametrize('name', [
    'rocket_12', 'rocket_', 'rocket_-1', 'rocket_01', 'rocket_+1', 'rocket_1 ', 'rocket_²',
    'rocket', '1', '', 'rocket_1/base_link', f'rocket_{"9" * 5000}'])
def test_only_the_names_of_rockets_are_names(name: str) -> None:
    assert entities.row_of(name, 12) is None


def test_a_name_leads_to_its_row() -> None:
    assert [entities.row_of(entities.name_of(row), 12) for row in range(12)] == list(range(12))


@pytest.mark.parametrize(('pattern', 'rows'), [
    ('', range(12)), ('rocket_1', (1,)), ('rocket_1.?', (1, 10, 11)),
    ('[[:alpha:]]+_[[:digit:]]', range(10)), ('^rocket_(2|3)$', (2, 3)), ('rocket', ()),
    ('rocket_[^[:digit:]]', ())])
def test_an_expression_matches_whole_names(pattern: str, rows: tuple[int, ...]) -> None:
    assert entities.rows_named(pattern, 12) == list(rows)


@pytest.mark.parametrize('pattern', ['(', '*', '[[:nothing:]]', 'a{99999999999}', '(' * 500])
def test_an_invalid_expression_is_named(pattern: str) -> None:
    with pytest.raises(ValueError, match=r'filter: got .*expected a regular expression'):
        entities.rows_named(pattern, 12)


def test_an_endless_expression_is_aborted_and_other_timers_continue() -> None:
    before = signal.getsignal(signal.SIGALRM)
    left = signal.getitimer(signal.ITIMER_REAL)[0]
    began = time.monotonic()
    with pytest.raises(ValueError, match=r'takes less than 0\.1 s'):
        entities.rows_named('(' * 20 + '.*' + ')*' * 20 + 'x', 1000)
    assert time.monotonic() - began < 30.0
    assert signal.getsignal(signal.SIGALRM) == before
    assert (signal.getitimer(signal.ITIMER_REAL)[0] > 0.0) == (left > 0.0)


def test_states_are_in_the_world_frame_with_z_up() -> None:
    world = worlds.make('rocket', 3, seed=1)
    position, orientation, linear, angular = entities.states_of(world.telemetry(slice(None)))
    own = world.telemetry(slice(None)).position
    # The world's own y points up; see frames.
    np.testing.assert_array_equal(position[:, 2], own[:, 1])
    assert position.shape == linear.shape == angular.shape == (3, 3)
    np.testing.assert_allclose(np.linalg.norm(orientation, axis=1), 1.0)
    assert (linear[:, 2] < 0.0).all()


def test_a_sphere_holds_positions_within_its_radius() -> None:
    position = np.array([[0.0, 0.0, 5.0], [3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    assert entities.within(position, (0.0, 0.0, 0.0), 5.0).tolist() == [True, True, True]
    assert entities.within(position, (0.0, 0.0, 5.0), 1.0).tolist() == [True, False, False]
    assert not entities.within(position, (0.0, 0.0, 0.0), float('nan')).any()
