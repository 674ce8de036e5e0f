# SPDX-License-Identifier: Apache-2.0
"""What is seen of a lunar lander: its observation, and the potential that shapes its reward."""
from __future__ import annotations

import numpy as np

from rocket_sim_node.worlds import lunar_vehicle as vehicle
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools

OBSERVATION_NAMES = (
    'position_x', 'position_y', 'velocity_x', 'velocity_y', 'angle', 'angular_velocity',
    'right_contact', 'left_contact',
)
"""Gymnasium's order; its first leg is the one at positive x."""
_FRAMES = 50
"""1/s; Gymnasium scales velocities by it, whatever dt"""


def hull_origin(pose: F64) -> tuple[F64, F64]:
    """Return where the hulls' origins are, `(K,)` m each, given poses `(K, 3)` of their bodies."""
    x, y, angle = pose.T
    return x + np.sin(angle) * vehicle.BODY_CENTRE, y - np.cos(angle) * vehicle.BODY_CENTRE


def hull_velocity(pose: F64, velocity: F64) -> tuple[F64, F64]:
    """Return velocities of the hulls' own centres of gravity, `(K,)` m/s each.

    :param pose: `(K, 3)` m, m, rad, and `velocity` `(K, 3)` m/s, m/s, rad/s of their bodies.
    """
    arm = velocity[:, 2] * (vehicle.HULL_CENTRE - vehicle.BODY_CENTRE)
    return (
        velocity[:, 0] - arm * np.cos(pose[:, 2]), velocity[:, 1] - arm * np.sin(pose[:, 2]))


def observe(pose: F64, velocity: F64, touching: Bools) -> tuple[F32, F64]:
    """Return observations `(K, 8)` and the potential `(K,)` whose rise is rewarded.

    :param pose: `(K, 3)` m, m, rad, and `velocity` `(K, 3)` m/s, m/s, rad/s of the hulls' bodies.
    :param touching: `(K, 3)` which of hull, left and right leg touch the ground.
    """
    state = np.empty((8, len(pose)))
    x, y = hull_origin(pose)
    speed_x, speed_y = hull_velocity(pose, velocity)
    state[0] = x / vehicle.HALF_WIDTH
    state[1] = (y - vehicle.PAD_HEIGHT - vehicle.LEG_DOWN) / vehicle.HALF_HEIGHT
    state[2] = speed_x * (vehicle.HALF_WIDTH / _FRAMES)
    state[3] = speed_y * (vehicle.HALF_HEIGHT / _FRAMES)
    state[4] = pose[:, 2]
    state[5] = velocity[:, 2] * (20 / _FRAMES)
    state[6] = touching[:, vehicle.RIGHT]
    state[7] = touching[:, vehicle.LEFT]
    potential = 10 * (state[6] + state[7]) - 100 * (
        np.sqrt(state[0]**2 + state[1]**2) + np.sqrt(state[2]**2 + state[3]**2)
        + np.abs(state[4]))
    return np.ascontiguousarray(state.T, np.float32), potential
