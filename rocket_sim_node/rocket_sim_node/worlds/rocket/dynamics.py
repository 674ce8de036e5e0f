# SPDX-License-Identifier: Apache-2.0
"""Dynamics of rockets in flight, with observations and telemetry: N rigid bodies in NumPy arrays.

SI units, y up. Spherical inertia, thrust along the body's axis, torque about world X and Z, drag
against the velocity; semi-implicit Euler.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import NO_OUTCOME
from rocket_sim_node.worlds.base import Telemetry
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket.actuators import CommandLine
from rocket_sim_node.worlds.rocket.actuators import Engines
from rocket_sim_node.worlds.rocket.conditions import DRAWN_NAMES
from rocket_sim_node.worlds.rocket.drawn_vehicle import DrawnVehicles
from rocket_sim_node.worlds.rocket.episode_counters import EpisodeCounters
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

OBSERVATION_NAMES = (
    'position_x', 'position_y', 'position_z', 'velocity_x', 'velocity_y', 'velocity_z',
    'up_x', 'up_y', 'up_z', 'spin_x', 'spin_y', 'spin_z', 'pad_x', 'pad_y', 'pad_z',
)
ACTION_NAMES = ('throttle', 'rcs_x', 'rcs_z')
EXTENDED = 'extended'
"""Kind of observation that includes past actions and accelerations."""
_PAST_ACTIONS, _PAST_ACCELERATIONS = 5, 2
STANDARD_SIZE = len(OBSERVATION_NAMES)
_ACCELERATIONS_FROM = STANDARD_SIZE + _PAST_ACTIONS * len(ACTION_NAMES)
TURNED = (slice(0, STANDARD_SIZE), slice(_ACCELERATIONS_FROM, None))
"""Columns that are vectors in space, x, y and z of each."""
OUTCOME = 25
"""Row of the outcome in a capture."""
_DRAWN = 30
_DRY_MASS, _THRUST = (
    _DRAWN + DRAWN_NAMES.index(name) for name in ('dry_mass_factor', 'thrust_factor'))


def observation_names(settings: RocketSettings) -> tuple[str, ...]:
    """Return the names of an observation's columns."""
    if settings.observation != EXTENDED:
        return OBSERVATION_NAMES
    return (
        *OBSERVATION_NAMES,
        *(f'command_{ago}_{name}' for ago in range(1, _PAST_ACTIONS + 1)
          for name in ACTION_NAMES),
        *(f'acceleration_{ago}_{axis}' for ago in range(1, _PAST_ACCELERATIONS + 1)
          for axis in 'xyz'))


class RocketDynamics:
    """State and motion of N rockets; row k of every array is rocket k.

    The state is a structure of arrays: `position`, `velocity`, `spin` (angular velocity)
    `(3, N)`, `attitude` `(4, N)`, `fuel` `(N,)`, `gust` `(2, N)`; `age` `(N,)` counts steps;
    `accelerations` `(2, 3, N)` m/s^2, newest first, if they are observed, else `(0, 3, N)`.
    """

    feet = 0
    """Number of feet that can touch the ground."""
    in_plane = False
    """Whether rockets stay within the x-y plane."""

    def __init__(self, num_envs: int, settings: RocketSettings, seed: int) -> None:
        """Allocate the arrays; subclasses set the initial states."""
        self._all = slice(None)
        self._rows = np.arange(num_envs)
        self.extended = settings.observation == EXTENDED
        self._use(settings, seed)
        self.position = np.zeros((3, num_envs))
        self.velocity = np.zeros((3, num_envs))
        self.attitude = np.zeros((4, num_envs))
        self.spin = np.zeros((3, num_envs))
        self.fuel = np.zeros(num_envs)
        self.age = np.zeros(num_envs, np.int64)
        self.episode = np.zeros(num_envs, np.int64)
        self.gust = np.zeros((2, num_envs))
        self.engines = Engines(num_envs)
        self.log = EpisodeCounters(num_envs)
        self.accelerations = np.zeros((_PAST_ACCELERATIONS * self.extended, 3, num_envs))
        # Results of the last step, for telemetry only.
        self._torque = np.zeros((3, num_envs))
        self._disturbance = np.zeros((3, num_envs))
        self._reward = np.zeros(num_envs)
        self._touching = np.zeros((num_envs, self.feet), np.bool_)
        self._contact_force = np.zeros((3, num_envs))
        self._no_outcome = np.full(num_envs, NO_OUTCOME, np.uint8)

    def _use(self, settings: RocketSettings, seed: int) -> None:
        """Apply settings and a seed; episodes must be started or loaded afterwards."""
        self.settings = settings
        self._seed = seed
        self.vehicles = DrawnVehicles(len(self._rows), seed, settings, self.in_plane)
        self.line = CommandLine(len(self._rows), self._line_length(settings))

    def _line_length(self, settings: RocketSettings) -> int:
        """Return how many commands must be stored."""
        delay = settings.action_delay_high
        return max(delay + 1 if delay else 0, _PAST_ACTIONS * self.extended)

    def _advance(self, command: F64) -> None:
        """Integrate one step: forces, then velocities, then positions (semi-implicit Euler)."""
        s, v = self.settings, self.vehicles
        dt = s.dt / s.substeps
        throttle = (command[:, 0] + 1.0) * 0.5
        throttle = self.engines.follow(throttle, self.fuel, v, s)
        self._torque[0] = command[:, 1] * v.rcs_torque
        self._torque[2] = command[:, 2] * v.rcs_torque
        spin_gain = self._torque * (dt / s.inertia)
        yaw_kept = (1.0 - s.yaw_damping) ** (1.0 / s.substeps)
        if v.disturbed:
            self._disturbance[::2] = v.side + self.gust
        for substep in range(s.substeps):
            if substep:
                throttle *= self.fuel > 0.0
            per_mass = dt / (self.fuel + v.dry_mass)
            speed = rotation.norm(self.velocity)
            impulse = rotation.up_vector(self.attitude)
            impulse *= throttle * v.max_thrust * per_mass
            if v.windy:  # otherwise rounding must stay that of nominal flights
                against = self.velocity - v.wind
                against *= v.drag * rotation.norm(against) * per_mass
                self.velocity -= against
            else:
                self.velocity *= 1.0 - v.drag * speed * per_mass
            self.velocity += impulse
            self.velocity[1] -= v.fall
            if v.disturbed:
                self.velocity += self._disturbance * dt
            self.position += self.velocity * dt
            self.fuel -= throttle * v.burn
            np.maximum(self.fuel, 0.0, out=self.fuel)
            self.spin += spin_gain
            self.spin[1] *= yaw_kept
            self.attitude = rotation.integrate(self.attitude, self.spin, dt)
        self.log.note_flight(speed, self.position[1], throttle, s.touchdown_height)

    def observe(self) -> F32:
        """Return the observation `(N, D)` of the current state."""
        return self._observe(self._all, rotation.up_vector(self.attitude))

    def _observe(self, rows: NDArray[np.integer] | slice, up: F64) -> F32:
        """Return the observation `(K, D)` of the selected rockets with the given up vectors."""
        s = self.settings
        position, velocity = self.position[:, rows], self.velocity[:, rows]
        if self.vehicles.noisy:
            position, velocity, up = self.vehicles.sense(
                rows, self.age[rows], position, velocity, up)
        observation = np.empty((
            _ACCELERATIONS_FROM + 3 * _PAST_ACCELERATIONS if self.extended else STANDARD_SIZE,
            up.shape[1]))
        np.divide(position, s.position_scale, out=observation[0:3])
        np.divide(velocity, s.velocity_scale, out=observation[3:6])
        observation[6:9] = up
        np.divide(self.spin[:, rows], s.spin_scale, out=observation[9:12])
        np.negative(observation[0:3], out=observation[12:15])
        observation[13] += s.touchdown_height / s.position_scale
        if self.extended:
            past = self.line.commands[:_PAST_ACTIONS, rows].transpose(0, 2, 1)
            observation[STANDARD_SIZE:_ACCELERATIONS_FROM] = past.reshape(-1, up.shape[1])
            felt = self.accelerations[:, :, rows].reshape(-1, up.shape[1])
            np.divide(felt, s.acceleration_scale, out=observation[_ACCELERATIONS_FROM:])
        np.minimum(observation, s.observation_limit, out=observation)
        np.maximum(observation, -s.observation_limit, out=observation)
        return np.ascontiguousarray(observation.T, dtype=np.float32)

    def capture(self, rows: NDArray[np.integer] | slice) -> F64:
        """Return the physical state of the selected rockets, `(K, S)`; see `telemetry_of`."""
        return np.concatenate((
            self._rows[None, rows], self.episode[None, rows], self.age[None, rows],
            self.position[:, rows], self.attitude[:, rows], self.velocity[:, rows],
            self.spin[:, rows], self.fuel[None, rows], self.engines.throttle[None, rows],
            self._torque[:, rows], self._contact_force[:, rows], self._reward[None, rows],
            self._no_outcome[None, rows], self.log.commanded[None, rows],
            self._disturbance[:, rows], self.vehicles.drawn[:, rows], self._touching.T[:, rows]))

    def telemetry_of(self, captured: F64) -> Telemetry:
        """Return the telemetry that a capture `(K, S)` holds."""
        count, s = captured.shape[1], self.settings
        drawn_to = _DRAWN + len(DRAWN_NAMES)
        row, episode, age = captured[:3].astype(np.int64)
        fuel, throttle, reward, outcome = captured[[16, 17, 24, OUTCOME]]
        return Telemetry(
            row=row, episode=episode, time=age * s.dt, position=captured[3:6].T,
            orientation=captured[6:10].T, linear_velocity=captured[10:13].T,
            angular_velocity=captured[13:16].T, fuel=fuel,
            mass=fuel + s.dry_mass * captured[_DRY_MASS],
            throttle=throttle, thrust=throttle * (s.max_thrust * captured[_THRUST]),
            lateral_thrust=np.zeros(count), torque=captured[18:21].T,
            contact_force=captured[21:24].T, contact=captured[drawn_to:].T.astype(np.bool_),
            leg_angle=np.zeros((count, self.feet)), terrain=np.zeros((count, 0)), reward=reward,
            outcome=outcome.astype(np.uint8), commanded_throttle=(captured[26] + 1.0) / 2,
            disturbance=captured[27:30].T, conditions=captured[_DRAWN:drawn_to].T,
        )

    def telemetry(self, rows: NDArray[np.integer] | slice) -> Telemetry:
        """Return the physical state of the selected rockets, S of them."""
        return self.telemetry_of(self.capture(rows))
