# SPDX-License-Identifier: Apache-2.0
"""Unit quaternions as structure of arrays: shape (4, N), order x y z w, body to world."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
_TINY = np.finfo(np.float64).tiny


def norm(vector: F64) -> F64:
    """Return the lengths of vectors `(D, N)`, `(N,)`.

    Written out, because an einsum sums in another order when N is 1, so that a single rocket
    would fly differently from one in a batch.
    """
    total = vector[0] * vector[0]
    for component in vector[1:]:
        total += component * component
    length: F64 = np.sqrt(total, out=total)
    return length


def from_pitch_roll(pitch: F64, roll: F64) -> F64:
    """Return the attitudes `(4, N)` that turn by `roll` about Z, then by `pitch` about X (rad)."""
    sin_p, cos_p = np.sin(pitch / 2), np.cos(pitch / 2)
    sin_r, cos_r = np.sin(roll / 2), np.cos(roll / 2)
    return np.stack((sin_p * cos_r, -sin_p * sin_r, cos_p * sin_r, cos_p * cos_r))


def up_vector(quaternion: F64) -> F64:
    """Return the body's up axis (Y) in the world, `(3, N)`."""
    x, y, z, w = quaternion
    up = np.empty((3, len(x)))
    up[0] = 2 * (x * y - w * z)
    up[1] = 1 - 2 * (x * x + z * z)
    up[2] = 2 * (y * z + w * x)
    return up


def multiply(left: F64, right: F64) -> F64:
    """Return the Hamilton product `(4, N)`: first `right`, then `left`."""
    lx, ly, lz, lw = left
    rx, ry, rz, rw = right
    product = np.empty_like(right)
    product[0] = lw * rx + lx * rw + ly * rz - lz * ry
    product[1] = lw * ry - lx * rz + ly * rw + lz * rx
    product[2] = lw * rz + lx * ry - ly * rx + lz * rw
    product[3] = lw * rw - lx * rx - ly * ry - lz * rz
    return product


def integrate(quaternion: F64, angular_velocity: F64, dt: float) -> F64:
    """Rotate attitudes by a constant world-frame angular velocity for `dt` seconds.

    The exponential map: exact for constant rates (Sola, 'Quaternion kinematics for the
    error-state Kalman filter', 2017, equation 214), then normalised against rounding.

    :param quaternion: `(4, N)`.
    :param angular_velocity: `(3, N)`, rad/s.
    :return: `(4, N)`.
    """
    # At rest sin(a) / a would be 0 / 0; the smallest positive angle gives the right limit, 1.
    half = np.maximum(norm(angular_velocity) * (0.5 * dt), _TINY)
    delta = np.empty_like(quaternion)
    delta[:3] = angular_velocity * (np.sin(half) / half * (0.5 * dt))
    delta[3] = np.cos(half)
    turned = multiply(delta, quaternion)
    turned /= norm(turned)
    return turned
