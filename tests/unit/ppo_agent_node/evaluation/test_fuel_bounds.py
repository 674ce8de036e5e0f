# SPDX-License-Identifier: Apache-2.0
"""The minimum-fuel bound against published numbers, an adaptive integrator and closed forms."""
from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ppo_agent_node.evaluation.optimum.fuel_bounds import StraightDropBound
from rocket_sim_node import worlds

SETTINGS = worlds.make('rocket').spec.settings


@pytest.mark.parametrize(('velocity', 'fuel'), [(0.0, 735.3), (-4.0, 736.7), (-15.0, 755.8)])
def test_reference_numbers(velocity: float, fuel: float) -> None:
    bound = StraightDropBound(SETTINGS)
    assert bound.fuel(np.array([velocity]))[0] == pytest.approx(fuel, abs=0.06)


def _by_scipy(speed: float) -> float:
    """Return the fuel from a bisection on the ignition height, integrated forwards."""
    s = SETTINGS
    drag = 0.5 * s['air_density'] * s['drag_coefficient'] * s['drag_area']
    mass = s['dry_mass'] + s['fuel']
    flow = s['max_thrust'] / (s['specific_impulse'] * s['gravity'])
    drop = s['spawn_height'] - s['touchdown_height']

    def until(event: int, start: list[float], thrust: float) -> np.ndarray:
        """Fly [height, downward speed, mass] until component `event` of it vanishes."""
        def rates(_: float, y: np.ndarray) -> list[float]:
            force = thrust + drag * y[1] * abs(y[1])
            return [-y[1], s['gravity'] - force / y[2], -flow * bool(thrust)]

        def crossing(_: float, y: np.ndarray) -> float:
            return float(y[event])

        crossing.terminal, crossing.direction = True, -1  # type: ignore[attr-defined]
        flown = solve_ivp(rates, (0, 100), start, events=crossing, rtol=1e-10, atol=1e-10)
        return flown.y[:, -1]

    def miss(height: float) -> float:
        fallen = until(0, [drop - height, speed, mass], 0.0)
        return float(until(1, [height, fallen[1], mass], s['max_thrust'])[0])

    ignition = brentq(miss, 5.0, drop - 1e-9, xtol=1e-10)
    fallen = until(0, [drop - ignition, speed, mass], 0.0)
    return float(mass - until(1, [ignition, fallen[1], mass], s['max_thrust'])[2])


@pytest.mark.parametrize('speed', [0.0, 7.5, 28.0])
def test_agrees_with_an_adaptive_integrator(speed: float) -> None:
    assert StraightDropBound(SETTINGS).fuel(np.array([-speed]))[0] == pytest.approx(
        _by_scipy(speed), abs=0.01)


def test_grows_with_the_speed_and_the_height() -> None:
    bound = StraightDropBound(SETTINGS)
    fuel = bound.fuel(-np.linspace(0, 60, 200))
    assert (np.diff(fuel) > 0).all()
    higher = StraightDropBound(SETTINGS, spawn_height=300.0)
    assert (higher.fuel(-np.linspace(0, 60, 200)) > fuel).all()


def test_without_drag_and_mass_loss_the_bound_is_the_textbook_formula() -> None:
    # Free fall to the speed V and braking at T/m - g over heights that add up to H:
    # V^2 / (2 g) + V^2 / (2 (T/m - g)) = H, burn time V / (T/m - g).
    settings = {**SETTINGS, 'air_density': 0.0, 'specific_impulse': 1e7}
    bound = StraightDropBound(settings)
    g, height = settings['gravity'], settings['spawn_height'] - settings['touchdown_height']
    net = settings['max_thrust'] / (settings['dry_mass'] + settings['fuel']) - g
    speed = math.sqrt(2 * height / (1 / g + 1 / net))
    assert bound.burn_time(np.zeros(1))[0] == pytest.approx(speed / net, rel=1e-6)


@pytest.mark.slow
def test_a_rocket_that_cannot_stop_has_no_bound_and_a_climb_counts_as_rest() -> None:
    bound = StraightDropBound(SETTINGS)
    assert np.isnan(bound.burn_time(np.array([95.0]))[0])
    speeds = np.linspace(0.0, 95.0, 500)
    assert np.array_equal(
        np.isnan(bound.fuel(-speeds)), np.isnan(StraightDropBound(SETTINGS).burn_time(speeds)))
    assert bound.fuel(np.array([3.0]))[0] == bound.fuel(np.array([0.0]))[0]
    assert bound.fuel(np.zeros(0)).shape == (0,)


@pytest.mark.parametrize('change', [
    {'max_thrust': 200_000.0}, {'max_thrust': 0.0}, {'fuel': 0.0}, {'fuel': 300.0}], ids=str)
def test_a_vehicle_that_cannot_land_has_no_bound(change: dict[str, float]) -> None:
    bound = StraightDropBound({**SETTINGS, **change})
    assert np.isnan(bound.fuel(np.array([0.0, -10.0]))).all()
