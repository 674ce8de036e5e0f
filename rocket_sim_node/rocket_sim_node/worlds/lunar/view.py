# SPDX-License-Identifier: Apache-2.0
"""Observation, reward-shaping potential and telemetry of the lunar lander."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Telemetry
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar.engines import Engines

OBSERVATION_NAMES = (
    'position_x', 'position_y', 'velocity_x', 'velocity_y', 'angle', 'angular_velocity',
    'right_contact', 'left_contact',
)
"""In Gymnasium's order; its first leg is the one at positive x."""
OUTCOME = 20
"""Row of the outcome in a capture."""
_FRAMES = 50
"""1/s; Gymnasium scales velocities by it, whatever dt."""


def seen_velocity(observation: NDArray[np.floating]) -> tuple[F64, F64]:
    """Return velocities in m/s, `(K,)` each, from scaled observations `(K, 8)`."""
    x, y = observation[:, 2:4].astype(np.float64).T
    return x * _FRAMES / vehicle.HALF_WIDTH, y * _FRAMES / vehicle.HALF_HEIGHT


def hull_origin(pose: F64) -> tuple[F64, F64]:
    """Return the positions of the hulls' origins, `(K,)` m each, from body poses `(K, 3)`."""
    x, y, angle = pose.T
    return x + np.sin(angle) * vehicle.BODY_CENTRE, y - np.cos(angle) * vehicle.BODY_CENTRE


def hull_velocity(pose: F64, velocity: F64) -> tuple[F64, F64]:
    """Return velocities of the hulls' own centres of gravity, `(K,)` m/s each.

    :param pose: `(K, 3)` m, m, rad, and `velocity` `(K, 3)` m/s, m/s, rad/s of their bodies.
    """
    arm = velocity[:, 2] * (vehicle.HULL_CENTRE - vehicle.BODY_CENTRE)
    return (
        velocity[:, 0] - arm * np.cos(pose[:, 2]), velocity[:, 1] - arm * np.sin(pose[:, 2]))


def tilt(pose: F64) -> F64:
    """Return the hulls' tilt from upright, `(K,)` deg, 0 to 180, regardless of full turns."""
    angle = pose[:, 2]
    leaning: F64 = np.rad2deg(np.abs(np.arctan2(np.sin(angle), np.cos(angle))))
    return leaning


def observe(pose: F64, velocity: F64, touching: Bools) -> tuple[F32, F64]:
    """Return observations `(K, 8)` and the shaping potential `(K,)`.

    :param pose: `(K, 3)` m, m, rad, and `velocity` `(K, 3)` m/s, m/s, rad/s of the hulls' bodies.
    :param touching: `(K, 3)` whether hull, left and right leg touch the ground.
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


def telemetry(captured: F64, engines: Engines) -> Telemetry:
    """Return a capture as telemetry relative to the pad.

    :param captured: `(35, S)` row, episode, time (s); poses (m, m, rad) of hull, left and right
        leg; velocity (m/s, m/s, rad/s) of the hull's body; throttle of the main engine, 0 to 1,
        and of the side engines, -1 (the left one, which pushes to the left) to 1; contact force
        (2, N); reward; outcome; whether hull, left and right leg touch; terrain (m).
    """
    pose, velocity, (main, side) = captured[3:12].T, captured[12:15].T, captured[15:17]
    flat = np.zeros(len(pose))
    hull = pose[:, :3]
    x, y = hull_origin(hull)
    half = hull[:, 2] / 2
    return Telemetry(
        row=captured[0].astype(np.int64), episode=captured[1].astype(np.int64), time=captured[2],
        position=np.stack((x, y - vehicle.PAD_GROUND, flat), axis=1),
        orientation=np.stack((flat, flat, np.sin(half), np.cos(half)), axis=1),
        linear_velocity=np.stack((*hull_velocity(hull, velocity), flat), axis=1),
        angular_velocity=np.stack((flat, flat, velocity[:, 2]), axis=1),
        mass=np.full(len(flat), vehicle.TOTAL_MASS), fuel=flat,
        throttle=main, thrust=main * engines.max_thrust,
        lateral_thrust=side * engines.max_lateral_thrust,
        torque=np.zeros((len(flat), 3)),
        contact_force=np.column_stack((*captured[17:19], flat)),
        contact=captured[22:24].T.astype(np.bool_),
        leg_angle=np.abs(pose[:, 5::3] - hull[:, 2:]) - vehicle.LEG_INNER,
        terrain=captured[24:].T - vehicle.PAD_GROUND, reward=captured[19],
        outcome=captured[OUTCOME].astype(np.uint8), commanded_throttle=main,
        disturbance=np.zeros((len(flat), 3)), conditions=np.zeros((len(flat), 0)),
    )
