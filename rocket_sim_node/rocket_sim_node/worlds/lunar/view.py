# SPDX-License-Identifier: Apache-2.0
"""Observation, reward-shaping potential and telemetry of the lunar lander."""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar.engines import FEW
from rocket_sim_node.worlds.lunar.engines import Engines
from rocket_sim_node.worlds.lunar.engines import side_torque

OBSERVATION_NAMES = (
    'position_x', 'position_y', 'velocity_x', 'velocity_y', 'angle', 'angular_velocity',
    'right_contact', 'left_contact',
)
"""In Gymnasium's order; its first leg is the one at positive x."""
_FRAMES = 50
"""1/s; Gymnasium scales velocities by it, whatever dt."""


def seen_velocity(observation: NDArray[np.floating]) -> tuple[F64, F64]:
    """Return velocities in m/s, `(K,)` each, from scaled observations `(K, 8)`."""
    x, y = observation[:, 2:4].astype(np.float64).T
    return x * _FRAMES / vehicle.HALF_WIDTH, y * _FRAMES / vehicle.HALF_HEIGHT


def seen_height(observation: NDArray[np.floating]) -> F64:
    """Return heights above touchdown in m, `(K,)`, from scaled observations `(K, 8)`."""
    above_flags = observation[:, 1].astype(np.float64) * vehicle.HALF_HEIGHT
    height: F64 = above_flags + vehicle.PAD_HEIGHT - vehicle.PAD_GROUND
    return height


def hull_origin(pose: F64) -> tuple[F64, F64]:
    """Return the positions of the hulls' origins, `(K,)` m each, from body poses `(K, 3)`."""
    x, y, angle = pose.T
    return _origin(x, y, np.sin(angle), np.cos(angle))


def hull_velocity(pose: F64, velocity: F64, point: float) -> tuple[F64, F64]:
    """Return velocities of a point of the hulls, `(K,)` m/s each.

    :param pose: `(K, 3)` m, m, rad, and `velocity` `(K, 3)` m/s, m/s, rad/s of their bodies.
    :param point: its height above the hull's origin, m.
    """
    angle = pose[:, 2]
    return _point_velocity(velocity.T, np.sin(angle), np.cos(angle), point)


def _origin(x: Any, y: Any, sin: Any, cos: Any) -> tuple[Any, Any]:
    """Return the origin of one hull, or of `(K,)`, from the position of its body; see `FEW`."""
    return x + sin * vehicle.BODY_CENTRE, y - cos * vehicle.BODY_CENTRE


def _point_velocity(velocity: Any, sin: Any, cos: Any, point: float) -> tuple[Any, Any]:
    """Return the velocity of a point of one hull, or of `(K,)`; see `hull_velocity`."""
    x, y, spin = velocity
    arm = spin * (point - vehicle.BODY_CENTRE)
    return x - arm * cos, y - arm * sin


def tilt(pose: F64) -> F64:
    """Return the hulls' tilt from upright, `(K,)` rad, 0 to pi, regardless of full turns."""
    angle = pose[:, 2]
    leaning: F64 = np.abs(np.arctan2(np.sin(angle), np.cos(angle)))
    return leaning


def observe(
    pose: F64, velocity: F64, touching: Bools, sin: F64, cos: F64,
) -> tuple[F32, F64]:
    """Return observations `(K, 8)` and the shaping potential `(K,)`.

    :param pose: `(K, 3)` m, m, rad, and `velocity` `(K, 3)` m/s, m/s, rad/s of the hulls' bodies.
    :param touching: `(K, 3)` whether hull, left and right leg touch the ground.
    :param sin: `(K,)` and `cos` `(K,)` of the hulls' angles.
    """
    if len(pose) > FEW:
        *state, potential = _observed(
            pose.T, velocity.T, touching.T.astype(np.float64), sin, cos, np.sqrt)
        return np.ascontiguousarray(np.array(state).T, np.float32), potential
    arrays = pose, velocity, touching, sin, cos
    found = np.array([
        _observed(place, motion, touch, sine, cosine, math.sqrt)
        for place, motion, touch, sine, cosine in zip(
            *(array.tolist() for array in arrays), strict=True)]).reshape(-1, 9)
    return found[:, :8].astype(np.float32), found[:, 8]


def _observed(
    pose: Any, velocity: Any, touching: Any, sin: Any, cos: Any, sqrt: Callable[[Any], Any],
) -> tuple[Any, ...]:
    """Return the observation and the potential of one lander or of `(K,)`; see `FEW`.

    Each of pose, velocity and touching is a sequence of three.
    """
    (x, y, angle), (_, _, spin), (_, left, right) = pose, velocity, touching
    # As in Gymnasium: the position of the hull's origin, the velocity of its centre of gravity.
    x, y = _origin(x, y, sin, cos)
    velocity_x, velocity_y = _point_velocity(velocity, sin, cos, vehicle.HULL_CENTRE)
    x /= vehicle.HALF_WIDTH
    y = (y - vehicle.PAD_HEIGHT - vehicle.LEG_DOWN) / vehicle.HALF_HEIGHT
    velocity_x *= vehicle.HALF_WIDTH / _FRAMES
    velocity_y *= vehicle.HALF_HEIGHT / _FRAMES
    potential = 10 * (right + left) - 100 * (
        sqrt(x * x + y * y) + sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
        + abs(angle))
    return x, y, velocity_x, velocity_y, angle, spin * (20 / _FRAMES), right, left, potential


def telemetry(known: Mapping[str, F64], engines: Engines) -> dict[str, NDArray[Any]]:
    """Return quantities relative to the pad, `(S,)` or `(k, S)`, of what was captured.

    :param known: `pose` `(9, S)` m, m, rad of hull, left and right leg; `velocity` `(3, S)` m/s,
        m/s, rad/s of the hull's body; throttle of the `main` engine, 0 to 1, and of the `side`
        engines, -1 (the left one, which pushes to the left) to 1; `ground_force` `(2, S)` N;
        `touching` `(3, S)` whether hull, left and right leg touch; `heights` of the terrain, m.
    """
    pose, velocity, main = known['pose'], known['velocity'], known['main']
    hull = pose[:3].T
    x, y = hull_origin(hull)
    half = pose[2] / 2
    flat = np.zeros_like(half)
    lateral = known['side'] * engines.max_lateral_thrust
    return {
        'position': np.stack((x, y - vehicle.PAD_GROUND, flat)),
        'orientation': np.stack((flat, flat, np.sin(half), np.cos(half))),
        'linear_velocity': np.stack((*hull_velocity(hull, velocity.T, 0.0), flat)),
        'angular_velocity': np.stack((flat, flat, velocity[2])),
        'mass': np.full_like(flat, vehicle.TOTAL_MASS),
        'throttle': main, 'commanded_throttle': main, 'thrust': main * engines.max_thrust,
        'lateral_thrust': lateral,
        'torque': np.stack((flat, flat, side_torque(lateral, np.sin(pose[2]), np.cos(pose[2])))),
        'contact_force': np.stack((*known['ground_force'], flat)),
        'contact': known['touching'][1:],
        'leg_angle': np.abs(pose[5::3] - pose[2]) - vehicle.LEG_INNER,
        'terrain': known['heights'] - vehicle.PAD_GROUND,
    }
