# SPDX-License-Identifier: Apache-2.0
"""Rockets in flight: N rigid bodies as one batch of NumPy arrays, how they move, how they look.

SI units, y up. Spherical inertia, thrust along the body's axis, torque about world X and Z, drag
against the velocity; semi-implicit Euler.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import rotation
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import NO_OUTCOME
from rocket_sim_node.worlds.base import Telemetry
from rocket_sim_node.worlds.vehicle import RocketSettings

OBSERVATION_NAMES = (
    'position_x', 'position_y', 'position_z', 'velocity_x', 'velocity_y', 'velocity_z',
    'up_x', 'up_y', 'up_z', 'spin_x', 'spin_y', 'spin_z', 'pad_x', 'pad_y', 'pad_z',
)
ACTION_NAMES = ('throttle', 'rcs_x', 'rcs_z')
OUTCOME = 25
"""where in a capture the outcome is"""


class RocketFlight:
    """State and motion of N rockets; row k of every array is rocket k.

    State is kept as structure of arrays: `position`, `velocity`, `spin` (angular velocity)
    `(3, N)`, `attitude` `(4, N)`, `fuel` `(N,)`; `age` `(N,)` counts steps.
    """

    feet = 0
    """How many feet can touch the ground."""

    def __init__(self, num_envs: int, settings: RocketSettings) -> None:
        """Make the arrays; where the rockets are is up to others."""
        self._use(settings)
        self._all = slice(None)
        self._rows = np.arange(num_envs)
        self.position = np.zeros((3, num_envs))
        self.velocity = np.zeros((3, num_envs))
        self.attitude = np.zeros((4, num_envs))
        self.spin = np.zeros((3, num_envs))
        self.fuel = np.zeros(num_envs)
        self.age = np.zeros(num_envs, np.int64)
        self.episode = np.zeros(num_envs, np.int64)
        # What the last step did, for telemetry only.
        self._throttle = np.zeros(num_envs)
        self._torque = np.zeros((3, num_envs))
        self._reward = np.zeros(num_envs)
        self._touching = np.zeros((num_envs, self.feet), np.bool_)
        self._contact_force = np.zeros((3, num_envs))
        self._no_outcome = np.full(num_envs, NO_OUTCOME, np.uint8)

    def _use(self, settings: RocketSettings) -> None:
        """Put settings into force."""
        self.settings = settings
        self._drag = (
            0.5 * settings.air_density * settings.drag_coefficient * settings.drag_area)

    def _advance(self, command: F64) -> None:
        """Integrate one step: forces, then velocities, then positions (semi-implicit Euler)."""
        s = self.settings
        dt = s.dt / s.substeps
        throttle = (command[:, 0] + 1.0) * 0.5
        throttle[throttle <= s.throttle_cutoff] = 0.0
        self._torque[0] = command[:, 1] * s.rcs_torque
        self._torque[2] = command[:, 2] * s.rcs_torque
        spin_gain = self._torque * (dt / s.inertia)
        yaw_kept = (1.0 - s.yaw_damping) ** (1.0 / s.substeps)
        flow = s.max_thrust / (s.specific_impulse * s.gravity) if s.gravity else 0.0
        for _ in range(s.substeps):
            throttle[self.fuel <= 0.0] = 0.0
            per_mass = dt / (self.fuel + s.dry_mass)
            speed = rotation.norm(self.velocity)
            impulse = rotation.up_vector(self.attitude)
            impulse *= throttle * s.max_thrust * per_mass
            self.velocity *= 1.0 - self._drag * speed * per_mass
            self.velocity += impulse
            self.velocity[1] -= s.gravity * dt
            self.position += self.velocity * dt
            self.fuel -= throttle * (flow * dt)
            np.maximum(self.fuel, 0.0, out=self.fuel)
            self.spin += spin_gain
            self.spin[1] *= yaw_kept
            self.attitude = rotation.integrate(self.attitude, self.spin, dt)
        self._throttle = throttle

    def observe(self) -> F32:
        """Return the observation `(N, 15)` of the present state."""
        return self._observe(self._all, rotation.up_vector(self.attitude))

    def _observe(self, rows: NDArray[np.integer] | slice, up: F64) -> F32:
        """Return the observation `(K, 15)` of the chosen rockets, whose up vectors are given."""
        s = self.settings
        observation = np.empty((15, up.shape[1]))
        np.divide(self.position[:, rows], s.position_scale, out=observation[0:3])
        np.divide(self.velocity[:, rows], s.velocity_scale, out=observation[3:6])
        observation[6:9] = up
        np.divide(self.spin[:, rows], s.spin_scale, out=observation[9:12])
        np.negative(observation[0:3], out=observation[12:15])
        observation[13] += s.touchdown_height / s.position_scale
        np.minimum(observation, s.observation_limit, out=observation)
        np.maximum(observation, -s.observation_limit, out=observation)
        return np.ascontiguousarray(observation.T, dtype=np.float32)

    def capture(self, rows: NDArray[np.integer] | slice) -> F64:
        """Return the physical state of the chosen rockets, `(K, S)`; see `telemetry_of`."""
        return np.concatenate((
            self._rows[None, rows], self.episode[None, rows], self.age[None, rows],
            self.position[:, rows], self.attitude[:, rows], self.velocity[:, rows],
            self.spin[:, rows], self.fuel[None, rows], self._throttle[None, rows],
            self._torque[:, rows], self._contact_force[:, rows], self._reward[None, rows],
            self._no_outcome[None, rows], self._touching.T[:, rows]))

    def telemetry_of(self, captured: F64) -> Telemetry:
        """Return what a capture `(K, S)` says."""
        count = captured.shape[1]
        row, episode, age = captured[:3].astype(np.int64)
        fuel, throttle, reward, outcome = captured[[16, 17, 24, OUTCOME]]
        return Telemetry(
            row=row, episode=episode, time=age * self.settings.dt, position=captured[3:6].T,
            orientation=captured[6:10].T, linear_velocity=captured[10:13].T,
            angular_velocity=captured[13:16].T, mass=fuel + self.settings.dry_mass, fuel=fuel,
            throttle=throttle, thrust=throttle * self.settings.max_thrust,
            lateral_thrust=np.zeros(count), torque=captured[18:21].T,
            contact_force=captured[21:24].T, contact=captured[26:].T.astype(np.bool_),
            leg_angle=np.zeros((count, self.feet)), terrain=np.zeros((count, 0)), reward=reward,
            outcome=outcome.astype(np.uint8), commanded_throttle=throttle,
            disturbance=np.zeros((count, 3)), conditions=np.zeros((count, 0)),
        )

    def telemetry(self, rows: NDArray[np.integer] | slice) -> Telemetry:
        """Return the physical state of the chosen rockets, S of them."""
        return self.telemetry_of(self.capture(rows))
