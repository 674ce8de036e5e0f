# SPDX-License-Identifier: Apache-2.0
"""Dynamics of rockets in flight, with observations and telemetry: N rigid bodies in NumPy arrays.

SI units, y up. Spherical inertia, thrust along the body's axis, torque about world X and Z, drag
against the velocity; semi-implicit Euler. Within a step, drag slows a rocket at most to the speed
of the air.
"""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.capture import StateCapture
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
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
_DRY_MASS, _THRUST = map(DRAWN_NAMES.index, ('dry_mass_factor', 'thrust_factor'))


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


class RocketDynamics(StateCapture):
    """State and motion of N rockets; row k of every array is rocket k.

    The state is a structure of arrays: `position`, `velocity`, `spin` (angular velocity)
    `(3, N)`, `attitude` `(4, N)`, `fuel` `(N,)`, `gust` `(2, N)`; `age` `(N,)` counts steps;
    `accelerations` `(2, 3, N)` m/s^2, newest first, if they are observed, else `(0, 3, N)`.
    """

    feet = 0
    """Number of feet that can touch the ground."""
    in_plane = False
    """Whether rockets stay within the x-y plane."""
    captured: ClassVar[Mapping[str, str]] = {
        'age': 'age', 'commanded': 'log.commanded', 'contact': '_touching.T'}

    def __init__(self, num_envs: int, settings: RocketSettings, seed: int) -> None:
        """Allocate the arrays; subclasses set the initial states."""
        self._all = slice(None)
        self.rows = np.arange(num_envs)
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
        self.torque = np.zeros((3, num_envs))
        self.disturbance = np.zeros((3, num_envs))
        self.reward = np.zeros(num_envs)
        self._touching = np.zeros((num_envs, self.feet), np.bool_)
        self.contact_force = np.zeros((3, num_envs))
        self.no_outcome = np.full(num_envs, NO_OUTCOME, np.uint8)

    def _use(self, settings: RocketSettings, seed: int) -> None:
        """Apply settings and a seed; episodes must be started or loaded afterwards."""
        self.settings = settings
        self._seed = seed
        self.vehicles = DrawnVehicles(len(self.rows), seed, settings, self.in_plane)
        self.line = CommandLine(len(self.rows), self._line_length(settings))

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
        self.torque[0] = command[:, 1] * v.rcs_torque
        self.torque[2] = command[:, 2] * v.rcs_torque
        spin_gain = self.torque * (dt / s.inertia)
        yaw_kept = (1.0 - s.yaw_damping) ** (1.0 / s.substeps)
        if v.disturbed:
            self.disturbance[::2] = v.side + self.gust
        for substep in range(s.substeps):
            if substep:
                # Not in place: that of the step is reported, even if fuel runs out in it.
                throttle = throttle * (self.fuel > 0.0)
            per_mass = dt / (self.fuel + v.dry_mass)
            speed = rotation.norm(self.velocity)
            if not substep:
                first_speed = speed
            impulse = rotation.up_vector(self.attitude)
            impulse *= throttle * v.max_thrust * per_mass
            if v.windy:  # otherwise rounding must stay that of nominal flights
                against = self.velocity - v.wind
                against *= np.minimum(v.drag * rotation.norm(against) * per_mass, 1.0)
                self.velocity -= against
            else:
                self.velocity *= np.maximum(1.0 - v.drag * speed * per_mass, 0.0)
            self.velocity += impulse
            self.velocity[1] -= v.fall
            if v.disturbed:
                self.velocity += self.disturbance * dt
            self.position += self.velocity * dt
            self.fuel -= throttle * v.burn
            np.maximum(self.fuel, 0.0, out=self.fuel)
            self.spin += spin_gain
            self.spin[1] *= yaw_kept
            self.attitude = rotation.integrate(self.attitude, self.spin, dt)
        self.log.note_flight(
            first_speed, self.position[1], self.engines.throttle, self.engines.lit,
            s.touchdown_height)

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

    def _derived(self, known: Mapping[str, F64]) -> dict[str, NDArray[Any]]:
        s, drawn = self.settings, known['conditions']
        return {
            'time': known['age'] * s.dt, 'mass': known['fuel'] + s.dry_mass * drawn[_DRY_MASS],
            'thrust': known['throttle'] * (s.max_thrust * drawn[_THRUST]),
            'commanded_throttle': (known['commanded'] + 1.0) / 2,
            'leg_angle': np.zeros_like(known['contact']),
        }
