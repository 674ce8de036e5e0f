# SPDX-License-Identifier: Apache-2.0
"""Outcomes and what they are worth, against tables worked out by hand."""
from __future__ import annotations

import numpy as np
import pytest

from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.worlds.rocket import outcome
from rocket_sim_node.worlds.rocket.vehicle import TaskSettings

TASK = TaskSettings()


def test_outcomes_stand_in_the_order_of_the_specification() -> None:
    """The wire sends their index."""
    assert outcome.OUTCOMES == (
        'landed', 'too_fast', 'tipped', 'off_pad', 'tilt_limit', 'timeout', 'out_of_bounds')
    assert len(outcome.OUTCOMES) <= NO_OUTCOME


@pytest.mark.parametrize(('speed', 'tilt', 'distance', 'expected'), [
    (0.0, 0.0, 0.0, 'landed'),
    (2.999999, 9.999999, 14.999999, 'landed'),
    (3.0, 0.0, 0.0, 'too_fast'),
    (0.0, 10.0, 0.0, 'tipped'),
    (0.0, 0.0, 15.0, 'off_pad'),
    (3.0, 10.0, 15.0, 'too_fast'),
    (2.9, 10.0, 15.0, 'tipped'),
    (2.9, 9.9, 15.0, 'off_pad'),
    (60.0, 180.0, 1e4, 'too_fast'),
])
def test_touchdown(speed: float, tilt: float, distance: float, expected: str) -> None:
    """Landed is strictly within all three; else the first that is not met."""
    got = outcome.judge_touchdown(
        np.array([speed]), np.array([tilt]), np.array([distance]), TASK)
    assert got.dtype == np.uint8
    assert outcome.OUTCOMES[got[0]] == expected


def test_flight_limits_in_their_order() -> None:
    """All eight combinations: tilt before time before bounds."""
    tilted, late, outside = np.array(np.meshgrid(*[[False, True]] * 3, indexing='ij')).reshape(
        3, 8)
    got = outcome.judge_flight(tilted, late, outside)
    assert [outcome.OUTCOMES[k] if k != NO_OUTCOME else None for k in got] == [
        None, 'out_of_bounds', 'timeout', 'timeout'] + ['tilt_limit'] * 4


@pytest.mark.parametrize(('speed', 'tilt', 'distance', 'expected'), [
    (0.0, 0.0, 0.0, 300.0),
    (3.0, 10.0, 15.0, 100.0),
    (1.5, 5.0, 7.5, 200.0),
    (1.5, 0.0, 0.0, 250.0),
    (0.0, 5.0, 0.0, 275.0),
    (0.0, 0.0, 7.5, 275.0),
    (0.6, 2.0, 3.0, 260.0),
])
def test_a_landing_earns_100_to_300(
    speed: float, tilt: float, distance: float, expected: float,
) -> None:
    """Each term by hand."""
    got = outcome.terminal_reward(
        np.array([outcome.LANDED], np.uint8), np.array([speed]), np.array([tilt]),
        np.array([distance]), TASK)
    assert got == pytest.approx([expected], abs=1e-12)


def test_every_crash_costs_100() -> None:
    """A slow, upright, centred crash is no better than another."""
    crashes = np.arange(1, 7, dtype=np.uint8)
    zero = np.zeros(6)
    assert outcome.terminal_reward(crashes, zero, zero, zero, TASK).tolist() == [-100.0] * 6


@pytest.mark.parametrize(('dt', 'limit', 'expected'), [
    (0.02, 30.0, 1500), (0.1, 30.0, 300), (0.01, 30.0, 3000), (0.03, 30.0, 1000),
    (0.07, 30.0, 428), (0.02, 0.05, 2), (0.1, 0.3, 3), (1e-4, 30.0, 300_000),
])
def test_step_limit_is_the_last_step_within_the_time(
    dt: float, limit: float, expected: int,
) -> None:
    """As many whole steps as fit, though 0.3 / 0.1 is below 3 in binary."""
    assert outcome.step_limit(TaskSettings(time_limit=limit), dt) == expected
