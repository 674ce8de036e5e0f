# SPDX-License-Identifier: Apache-2.0
"""Quaternions against SciPy's rotations, which share no line with ours."""
from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rocket_sim_node.worlds.rocket import rotation

F64 = NDArray[np.float64]


@pytest.fixture
def attitudes() -> F64:
    """Return 100 attitudes `(4, 100)` from all over the sphere."""
    quaternions: F64 = Rotation.random(100, random_state=1).as_quat().T
    return quaternions


def assert_same_rotation(got: F64, expected: Rotation, atol: float = 1e-12) -> None:
    """Compare as rotations: a quaternion and its negative are the same."""
    assert (Rotation.from_quat(got.T) * expected.inv()).magnitude() == pytest.approx(0, abs=atol)


def test_up_vector_is_the_turned_y_axis(attitudes: F64) -> None:
    """`up` is body Y seen from the world."""
    expected = Rotation.from_quat(attitudes.T).apply([0, 1, 0]).T
    assert rotation.up_vector(attitudes) == pytest.approx(expected, abs=1e-14)


def test_multiply_is_composition(attitudes: F64) -> None:
    """The right one turns first."""
    left, right = attitudes[:, :50], attitudes[:, 50:]
    expected = Rotation.from_quat(left.T) * Rotation.from_quat(right.T)
    assert_same_rotation(rotation.multiply(left, right), expected)


def test_pitch_turns_about_x_and_roll_about_z() -> None:
    """Roll first, then pitch; the up vector has its closed form."""
    pitch, roll = np.random.default_rng(2).uniform(-3, 3, (2, 100))
    attitude = rotation.from_pitch_roll(pitch, roll)
    zero = np.zeros(100)
    about_x = Rotation.from_rotvec(np.stack((pitch, zero, zero), axis=1))
    about_z = Rotation.from_rotvec(np.stack((zero, zero, roll), axis=1))
    assert_same_rotation(attitude, about_x * about_z)
    assert rotation.up_vector(attitude) == pytest.approx(np.stack((
        -np.sin(roll), np.cos(roll) * np.cos(pitch), np.cos(roll) * np.sin(pitch))), abs=1e-14)
    assert np.linalg.norm(attitude, axis=0) == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize('size', [1e-12, 1e-6, 1e-3, 1.0, 30.0])
def test_integrate_is_exact_for_constant_rates(attitudes: F64, size: float) -> None:
    """The exponential map, from rates that hardly turn to several turns a second."""
    rate = np.random.default_rng(3).normal(size=(3, 100)) * size
    expected = Rotation.from_rotvec(rate.T * 0.5) * Rotation.from_quat(attitudes.T)
    assert_same_rotation(rotation.integrate(attitudes, rate, 0.5), expected)


def test_integrate_at_rest_changes_nothing(attitudes: F64) -> None:
    """No division by the angle, which is zero."""
    with np.errstate(all='raise'):
        still = rotation.integrate(attitudes, np.zeros((3, 100)), 0.02)
    assert still == pytest.approx(attitudes, abs=1e-15)


def test_a_hundred_thousand_turns_keep_the_norm(attitudes: F64) -> None:
    """Rounding does not add up."""
    rate = np.random.default_rng(4).normal(size=(3, 100))
    turned = attitudes
    for _ in range(1000):
        turned = rotation.integrate(turned, rate, 0.02)
    assert np.linalg.norm(turned, axis=0) == pytest.approx(1, abs=1e-15)
    expected = Rotation.from_rotvec(rate.T * 20) * Rotation.from_quat(attitudes.T)
    assert_same_rotation(turned, expected, atol=1e-11)


def test_the_rate_is_in_the_world_not_in_the_body(attitudes: F64) -> None:
    """The body-frame product, quaternion times delta, is another rotation."""
    rate = np.random.default_rng(5).normal(size=(3, 100))
    body = Rotation.from_quat(attitudes.T) * Rotation.from_rotvec(rate.T)
    ours = Rotation.from_quat(rotation.integrate(attitudes, rate, 1.0).T)
    assert np.median((ours * body.inv()).magnitude()) > 0.1


def test_one_euler_step_would_be_wrong(attitudes: F64) -> None:
    """First order in the angle, q + dt/2 w q, misses by the angle cubed over twelve."""
    rate = np.tile([[0.0], [0.0], [2.0]], 100)
    euler = attitudes + 0.5 * rotation.multiply(np.vstack((rate, np.zeros(100))), attitudes)
    euler /= np.linalg.norm(euler, axis=0)
    expected = Rotation.from_rotvec(rate.T) * Rotation.from_quat(attitudes.T)
    assert (Rotation.from_quat(euler.T) * expected.inv()).magnitude() == pytest.approx(
        2.0 - 2 * np.arctan(1.0), abs=1e-12)
