# SPDX-License-Identifier: Apache-2.0
"""The one place where the worlds' frame (y up) becomes that of ROS (REP 103, z up) and back.

Both frames are turned by a quarter about X, that of the world and that of the body, so that
(x, y, z) becomes (x, -z, y) and the body's axis towards the nose becomes its z.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

VECTORS = (
    'position', 'linear_velocity', 'angular_velocity', 'torque', 'disturbance', 'contact_force')
"""The quantities of a rocket's state that are vectors."""


def vector_to_ros(vector: F64) -> F64:
    """Return vectors `(S, 3)`, y up, as vectors with z up."""
    return np.stack((vector[:, 0], -vector[:, 2], vector[:, 1]), axis=1)


def vector_from_ros(vector: F64) -> F64:
    """Return vectors `(S, 3)`, z up, as vectors with y up."""
    return np.stack((vector[:, 0], vector[:, 2], -vector[:, 1]), axis=1)


def quaternion_to_ros(quaternion: F64) -> F64:
    """Return attitudes `(S, 4)` x y z w, y up, as attitudes with z up."""
    x, y, z, w = quaternion.T
    return np.stack((x, -z, y, w), axis=1)


def quaternion_from_ros(quaternion: F64) -> F64:
    """Return attitudes `(S, 4)` x y z w, z up, as attitudes with y up."""
    x, y, z, w = quaternion.T
    return np.stack((x, z, -y, w), axis=1)
