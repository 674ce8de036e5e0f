# SPDX-License-Identifier: Apache-2.0
"""World `rocket` against an integrator that shares no line with it.

The equations of motion are written here a second time, with rotation matrices instead of
quaternions, and solved by SciPy's DOP853 to 1e-11. The world is to near them in proportion to its
step, as a method of first order does.
"""
from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rocket_sim_node import worlds

F64 = NDArray[np.float64]

ROCKETS = 6
HOLD = 10
"""Steps for which a control is held."""
CONTROLS = 5
STEP = 0.02

_RANDOM = np.random.default_rng(20)
COMMANDS: F64 = _RANDOM.uniform(-1, 1, (CONTROLS, ROCKETS, 3)) * [1.0, 0.4, 0.4]
COMMANDS[2, 0, 0] = -1.0
POSITION: F64 = _RANDOM.uniform(-40, 40, (ROCKETS, 3)) + [0, 200, 0]
VELOCITY: F64 = _RANDOM.uniform(-30, 30, (ROCKETS, 3))
SPIN: F64 = _RANDOM.uniform(-0.5, 0.5, (ROCKETS, 3))


def motion(_time: float, state: F64, command: F64) -> F64:
    """Return the time derivative of position, velocity, spin, rotation matrix and fuel."""
    velocity, spin, matrix, fuel = state[3:6], state[6:9], state[9:18].reshape(3, 3), state[18]
    throttle = (command[0] + 1) / 2 if (command[0] + 1) / 2 > 0.01 and fuel > 0 else 0.0
    mass = 22_000 + fuel
    force = throttle * 470_880 * matrix[:, 1]
    force = force - 0.5 * 1.225 * 0.30 * 10.8 * np.linalg.norm(velocity) * velocity
    force = force + mass * np.array([0, -9.81, 0])
    # 5 % of the yaw rate a step, spread over the step.
    yaw_loss = np.log(0.95) / STEP * spin[1]
    turning = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
    return np.concatenate((
        velocity, force / mass,
        [command[1] * 2e6 / 5e5, yaw_loss, command[2] * 2e6 / 5e5],
        (turning @ matrix).ravel(), [-throttle * 470_880 / (282 * 9.81)],
    ))


@cache
def reference() -> F64:
    """Return the last states `(ROCKETS, 19)` by SciPy."""
    ends = []
    for k in range(ROCKETS):
        state = np.concatenate((POSITION[k], VELOCITY[k], SPIN[k], np.eye(3).ravel(), [2000.0]))
        for command in COMMANDS[:, k]:
            state = solve_ivp(
                motion, (0, HOLD * STEP), state, 'DOP853', args=(command,),
                rtol=1e-11, atol=1e-11).y[:, -1]
        ends.append(state)
    return np.array(ends)


@cache
def flown(substeps: int) -> F64:
    """Return position, velocity, spin, up vector and fuel of the world, `(ROCKETS, 13)`."""
    world = worlds.make(
        'rocket', ROCKETS, level=1, spawn_angle=0, substeps=substeps, tilt_limit=180.0)
    world.position[:], world.velocity[:], world.spin[:] = POSITION.T, VELOCITY.T, SPIN.T
    for command in COMMANDS:
        for _ in range(HOLD):
            assert not world.step(command)[2].any()
    x, y, z, w = world.attitude
    up = (2 * (x * y - w * z), w * w + y * y - x * x - z * z, 2 * (y * z + w * x))
    return np.vstack((world.position, world.velocity, world.spin, *up, world.fuel)).T


def errors(substeps: int) -> dict[str, float]:
    """Return the largest difference from SciPy's solution by quantity."""
    exact = reference()
    up = exact[:, [10, 13, 16]]
    difference = np.abs(flown(substeps) - np.hstack((exact[:, :9], up, exact[:, 18:])))
    parts = {'position': (0, 3), 'velocity': (3, 6), 'spin': (6, 9), 'up': (9, 12),
             'fuel': (12, 13)}
    return {name: float(difference[:, a:b].max()) for name, (a, b) in parts.items()}


def test_the_flights_are_worth_comparing() -> None:
    """They tilt, turn, burn and move, and one coasts with its engine off."""
    exact = reference()
    assert np.degrees(np.arccos(exact[:, 13])).max() > 30
    assert np.linalg.norm(exact[:, :3] - POSITION, axis=1).min() > 5
    assert exact[:, 18].max() < 1980


@pytest.mark.parametrize('substeps', [4, 8, 16, 32])
@pytest.mark.parametrize('quantity', ['position', 'velocity', 'up'])
def test_the_error_halves_with_the_step(quantity: str, substeps: int) -> None:
    """First order: neither less, nor by accident more."""
    ratio = errors(substeps)[quantity] / errors(2 * substeps)[quantity]
    assert np.log2(ratio) == pytest.approx(1, abs=0.1)


def test_fine_steps_come_near_the_solution() -> None:
    """At 100 substeps, after a second of flight."""
    error = errors(100)
    assert error['position'] < 1e-3
    assert error['velocity'] < 1e-3
    assert error['up'] < 2e-4


@pytest.mark.parametrize('substeps', [1, 8, 100])
def test_spin_and_fuel_are_exact_at_any_step(substeps: int) -> None:
    """Their rates do not depend on the state, so Euler's sum is the integral."""
    error = errors(substeps)
    assert error['spin'] < 1e-9
    assert error['fuel'] < 1e-8


def test_extrapolation_to_no_step_at_all() -> None:
    """Richardson: twice the finer less the coarser cancels the first order."""
    exact = reference()[:, :3]
    guess = 2 * flown(64)[:, :3] - flown(32)[:, :3]
    assert np.abs(guess - exact).max() < errors(64)['position'] / 50
