# SPDX-License-Identifier: Apache-2.0
"""Conversion between the worlds' frame (y up) and that of ROS (REP 103, z up).

World and body frames are both rotated by 90 degrees about X, so that (x, y, z) becomes (x, -z, y)
and the body's axis towards the nose becomes its z.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

WORLD = 'world'
"""Name of the world's frame of ROS, with its origin on the ground at the pad's centre."""


def vector_to_ros(vector: F64) -> F64:
    """Return y-up vectors `(S, 3)` as z-up vectors."""
    return np.stack((vector[:, 0], -vector[:, 2], vector[:, 1]), axis=1)


def vector_from_ros(vector: F64) -> F64:
    """Return z-up vectors `(S, 3)` as y-up vectors."""
    return np.stack((vector[:, 0], vector[:, 2], -vector[:, 1]), axis=1)


def quaternion_to_ros(quaternion: F64) -> F64:
    """Return y-up attitudes `(S, 4)`, x y z w, as z-up attitudes."""
    x, y, z, w = quaternion.T
    return np.stack((x, -z, y, w), axis=1)


def quaternion_from_ros(quaternion: F64) -> F64:
    """Return z-up attitudes `(S, 4)`, x y z w, as y-up attitudes."""
    x, y, z, w = quaternion.T
    return np.stack((x, z, -y, w), axis=1)


def to_body(quaternion: F64, vector: F64) -> F64:
    """Return world vectors `(n, 3)` in the frame of bodies with attitudes `(n, 4)`."""
    axis, real = -quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, vector)
    return vector + real * twice + np.cross(axis, twice)


def to_world(quaternion: F64, vector: F64) -> F64:
    """Return body vectors `(n, 3)` in the world, for attitudes `(n, 4)`."""
    return to_body(quaternion * (-1.0, -1.0, -1.0, 1.0), vector)
