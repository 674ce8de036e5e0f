# SPDX-License-Identifier: Apache-2.0
"""The lateral law of the expert: its closed-form solution, and the rate that is fed forward."""
from __future__ import annotations

import numpy as np
import pytest

from ppo_agent_node.pilots.expert.attitude import attitude_torque
from ppo_agent_node.pilots.expert.descent import TimeToGo
from ppo_agent_node.pilots.expert.lateral import LateralLaw

LAW = LateralLaw(power=5.0, least_time=0.1, reach=1e9, upright_time=1e-3)
POWER = LAW.power


def _to_go(time: float, coast: float = 0.0) -> TimeToGo:
    return TimeToGo(np.array([coast]), np.array([time]))


def _state(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, x' and x'' of x = t^p along one axis and -2 t^p along the other, t to go."""
    each = np.array([[1.0], [-2.0]])
    return (each * time**POWER, -each * POWER * time**(POWER - 1),
            each * POWER * (POWER - 1) * time**(POWER - 2))


@pytest.mark.parametrize('time', [0.3, 1.0, 4.0])
def test_a_power_of_the_time_to_go_solves_the_law(time: float) -> None:
    x, drift, push = _state(time)
    pull = LAW.pull(x, drift, push, _to_go(time))
    assert pull.acceleration == pytest.approx(push, rel=1e-9)
    jerk = -np.array([[1.0], [-2.0]]) * POWER * (POWER - 1) * (POWER - 2) * time**(POWER - 3)
    assert pull.rate == pytest.approx(jerk, rel=1e-9)


@pytest.mark.parametrize('law', [
    LAW, LateralLaw(5.0, 0.8, 1e9, 1e-3), LateralLaw(5.0, 0.1, 1e9, 0.9),
], ids=['shrinking', 'held', 'fading'])
def test_the_rate_is_that_of_the_pull(law: LateralLaw) -> None:
    """By central differences along x(s + d) = x + x' d + x'' d^2 / 2 while the burn shrinks."""
    x, drift, push = np.array([[0.7], [-0.4]]), np.array([[-0.5], [0.9]]), np.array([[2.0], [1.0]])
    d = 1e-5

    def at(offset: float) -> np.ndarray:
        return law.pull(x + drift * offset + push * offset**2 / 2, drift + push * offset, push,
                        _to_go(0.5 - offset)).acceleration

    expected = (at(d) - at(-d)) / (2 * d)
    assert law.pull(x, drift, push, _to_go(0.5)).rate == pytest.approx(expected, rel=1e-5)


def test_the_pull_fades_in_proportion_to_the_burn_left() -> None:
    fading = LateralLaw(5.0, 0.1, 1e9, upright_time=0.4)
    x, drift, push = _state(0.1)
    full = LAW.pull(x, drift, push, _to_go(0.1)).acceleration
    assert fading.pull(x, drift, push, _to_go(0.1)).acceleration == pytest.approx(full / 4)
    assert not fading.pull(x, drift, push, _to_go(0.0)).acceleration.any()


def test_a_coasting_rocket_waits_as_it_leans() -> None:
    x, drift, push = _state(2.0)
    assert not LAW.pull(x, drift, push, _to_go(2.0, coast=1.0)).rate.any()


@pytest.mark.parametrize(('x', 'drift', 'expected'), [
    (8.0, 0.0, 4.0),       # bang-bang from rest: 2 sqrt(x / A)
    (0.0, 0.0, 0.0),
    (4.0, -4.0, 2.0),      # stops on the axis at full reach: v / A
])
def test_the_shortest_way_is_that_of_bang_bang(x: float, drift: float, expected: float) -> None:
    law = LateralLaw(5.0, 0.1, reach=2.0, upright_time=1.0)
    found = law.shortest(np.array([[x], [0.0]]), np.array([[drift], [0.0]]))
    assert found == pytest.approx(expected, abs=1e-6)


def test_an_axis_that_turns_is_followed_without_lag() -> None:
    """On the wanted axis and turning with it there is nothing to do, whatever the spin."""
    up, spin = np.array([[0.0], [1.0], [0.0]]), np.array([[0.3], [-0.2]])
    asked = attitude_torque(up, spin, up, 4.0, 20.0, 0.8, 0.6, turning=spin)
    assert asked == pytest.approx(0.0, abs=1e-12)
    unaware = attitude_torque(up, spin, up, 4.0, 20.0, 0.8, 0.6)
    assert unaware == pytest.approx(-spin * (2 * 0.8 * 20.0 / 4.0))
