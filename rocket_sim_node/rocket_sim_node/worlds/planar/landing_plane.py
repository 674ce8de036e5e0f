# SPDX-License-Identifier: Apache-2.0
"""Vertical planes for simulating touchdowns: projection of 3-D states into them, and back.

The plane is that of the horizontal velocity if that is noticeable, else that of the lean, else
x-y. Within it x is counted along its horizontal direction, y upwards, and angles from x to y.
"""
from __future__ import annotations

import numpy as np

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket import rotation

NOTICEABLE_SPEED = 0.1
"""m/s, minimum horizontal speed that determines the plane."""
NOTICEABLE_LEAN = 0.1
"""deg, minimum tilt that determines the plane where the speed does not."""


class LandingPlane:
    """Planes of K rockets.

    `direction` `(2, K)`: x and z of the horizontal unit vector; `axis` `(3, K)`: horizontal x up,
    about which angles in the plane turn; `lean` `(K,)` rad: the rocket's lean within the plane.
    """

    def __init__(self, position: F64, orientation: F64, velocity: F64) -> None:
        """Choose the planes.

        :param position: `(K, 3)` m, y up.
        :param orientation: `(K, 4)` quaternion x y z w.
        :param velocity: `(K, 3)` m/s.
        """
        attitude = np.ascontiguousarray(orientation.T)
        up = rotation.up_vector(attitude)
        self._position = position
        self.direction = _directions(velocity[:, ::2].T, up[::2])
        along_x, along_z = self.direction
        self.axis = np.stack((-along_z, np.zeros_like(along_x), along_x))
        self.lean = np.arctan2(-(up[0] * along_x + up[2] * along_z), up[1])
        # Swing-twist decomposition: attitude = turn in the plane * lean across it * yaw.
        rest = rotation.multiply(_turn(self.axis, -self.lean), attitude)
        self._yaw = np.zeros_like(rest)
        size = np.hypot(rest[1], rest[3])
        self._yaw[1] = rest[1] / np.where(size == 0, 1.0, size)
        self._yaw[3] = np.where(size == 0, 1.0, rest[3] / np.where(size == 0, 1.0, size))
        across = rotation.multiply(rest, self._yaw * [[1.0], [-1.0], [1.0], [1.0]])
        across = np.where(across[3] < 0, -across, across)
        size = rotation.norm(across[:3])
        self._across = 2 * np.arctan2(size, across[3])
        self._across_axis = across[:3] / np.where(size == 0, 1.0, size)

    def rates(self, velocity: F64, spin: F64) -> F64:
        """Return the in-plane components of velocities, `(K, 3)`: m/s, m/s, rad/s.

        :param velocity: `(K, 3)` m/s.
        :param spin: `(K, 3)` rad/s.
        """
        along = velocity[:, 0] * self.direction[0] + velocity[:, 2] * self.direction[1]
        return np.stack((along, velocity[:, 1], (spin * self.axis.T).sum(1)), axis=1)

    def vector(self, x: F64, y: F64) -> F64:
        """Return in-plane vectors `(K,)`, `(K,)` as vectors in space `(K, 3)`."""
        return np.stack((x * self.direction[0], y, x * self.direction[1]), axis=1)

    def place(self, moved: F64, y: F64) -> F64:
        """Return positions `(K, 3)` m from the distance along the plane and the height."""
        where = self._position + self.vector(moved, y)
        where[:, 1] = y
        return where

    def spin(self, rate: F64) -> F64:
        """Return in-plane rates as angular velocities `(K, 3)` rad/s."""
        turning: F64 = rate[:, None] * self.axis.T
        return turning

    def orientation(self, angle: F64, across: float = 0.0) -> F64:
        """Return attitudes `(K, 4)` for angles `(K,)` rad in the plane, with unchanged yaw.

        :param across: remaining part of the lean across the plane.
        """
        lean = _turn(self._across_axis, across * self._across)
        attitude = rotation.multiply(
            _turn(self.axis, angle), rotation.multiply(lean, self._yaw))
        return np.ascontiguousarray(attitude.T)


def _directions(drift: F64, lean: F64) -> F64:
    """Return horizontal unit vectors `(2, K)` from horizontal velocities and up vectors."""
    direction = np.zeros_like(drift)
    direction[0] = 1.0
    # In order of increasing priority.
    for vector, noticeable in (
            (lean, np.sin(np.deg2rad(NOTICEABLE_LEAN))), (drift, NOTICEABLE_SPEED)):
        size = np.hypot(vector[0], vector[1])
        clear = size >= noticeable
        direction[:, clear] = vector[:, clear] / size[clear]
    return direction


def _turn(axis: F64, angle: F64) -> F64:
    """Return the quaternions `(4, K)` of turns by `angle` `(K,)` rad about axes `(3, K)`."""
    return np.concatenate((axis * np.sin(angle / 2), np.cos(angle / 2)[None]))
