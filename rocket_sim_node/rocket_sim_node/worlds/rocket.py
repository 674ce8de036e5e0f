# SPDX-License-Identifier: Apache-2.0
"""World `rocket`: powered landing in three dimensions, N rockets as one batch of NumPy arrays.

SI units, y up. Rigid body with a spherical inertia, thrust along its axis, torque about world X
and Z, drag against the velocity; semi-implicit Euler.
"""
from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import settings as settings_module
from rocket_sim_node.worlds import outcome as outcomes
from rocket_sim_node.worlds import rotation
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds import spawn
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import NO_OUTCOME
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import Telemetry
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.vehicle import RocketSettings

OBSERVATION_NAMES = (
    'position_x', 'position_y', 'position_z', 'velocity_x', 'velocity_y', 'velocity_z',
    'up_x', 'up_y', 'up_z', 'spin_x', 'spin_y', 'spin_z', 'pad_x', 'pad_y', 'pad_z',
)
ACTION_NAMES = ('throttle', 'rcs_x', 'rcs_z')


class RocketWorld:
    """N rockets that fall on a pad at the origin and have one burn to stop. A `VectorEnv`.

    Row k of every array is rocket k. State is kept as structure of arrays: `position`,
    `velocity`, `spin` (angular velocity) `(3, N)`, `attitude` `(4, N)`, `fuel` `(N,)`.
    Worlds that differ in some of this derive from it.
    """

    name = 'rocket'
    settings_class: type[RocketSettings] = RocketSettings
    settings: RocketSettings
    in_plane = False
    """Whether rockets start within the x-y plane."""
    feet = 0
    """How many feet can touch the ground."""

    def __init__(self, num_envs: int = 1, seed: int = 0, **settings: float) -> None:
        """Make the world and begin the first episodes.

        :raises ValueError: for a setting that is unknown or out of range.
        """
        self._made_with = settings_module.build(self.settings_class, settings)
        self._apply(self._made_with)
        self._rows = np.arange(num_envs)
        self._all = slice(None)
        self.position = np.zeros((3, num_envs))
        self.velocity = np.zeros((3, num_envs))
        self.attitude = np.zeros((4, num_envs))
        self.spin = np.zeros((3, num_envs))
        self.fuel = np.zeros(num_envs)
        self.age = np.zeros(num_envs, np.int64)
        self.episode = np.zeros(num_envs, np.int64)
        self.episode_return = np.zeros(num_envs)
        # What the last step did, for telemetry only.
        self._throttle = np.zeros(num_envs)
        self._torque = np.zeros((3, num_envs))
        self._reward = np.zeros(num_envs)
        self._touching = np.zeros((num_envs, self.feet), np.bool_)
        self._contact_force = np.zeros((3, num_envs))
        self._none_finished = self._finished = self.telemetry(self._rows[:0])
        self._seed = seed
        self.spec = WorldSpec(
            name=self.name, num_envs=num_envs, dt=self.settings.dt,
            observation_names=OBSERVATION_NAMES, action_names=ACTION_NAMES,
            continuous=True, action_low=(-1.0,) * 3, action_high=(1.0,) * 3,
            action_idle=(-1.0, 0.0, 0.0), action_count=0,
            outcomes=outcomes.OUTCOMES, settings=settings_module.as_dict(self._made_with),
        )
        self.reset(seed)

    def reset(self, seed: int | None = None, **settings: float) -> F32:
        """Begin new episodes of all rockets; see :class:`VectorEnv`."""
        unknown = sorted(set(settings) - set(spawn.CURRICULUM_SETTINGS))
        if unknown:
            raise ValueError(
                f'reset: unknown setting {", ".join(map(repr, unknown))}, '
                f'expected {", ".join(spawn.CURRICULUM_SETTINGS)}'
            )
        if seed is not None and not (
                isinstance(seed, int | np.integer) and 0 <= seed < 2**63):
            raise ValueError(
                f'reset: seed is {seed}, expected 0 to 2**63 - 1, a whole number')
        checked = settings_module.build(
            self.settings_class, {**settings_module.as_dict(self._made_with), **settings})
        new_seed, episode = (
            (self._seed, self.episode + 1) if seed is None
            else (seed, np.zeros_like(self.episode)))
        first = spawn.draw(
            new_seed, self._rows, episode, spawn.spawn_range(checked), checked, self.in_plane)
        self._apply(checked)
        self._seed, self.episode = new_seed, episode
        self._store_spawns()
        self._begin(self._rows, first)
        self._reward = np.zeros(self.spec.num_envs)
        self._finished = self._none_finished
        return self.observe()

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by `dt`; see :class:`VectorEnv`."""
        command = checked_action(self.spec, action)
        self._advance(command)
        self.age += 1
        up = rotation.up_vector(self.attitude)
        observation = self._observe(self._all, up)
        done = self._ended(up[1])
        reward = np.full(self.spec.num_envs, self.settings.reward_step)
        info: dict[str, Any] = {
            'final_rows': done, 'final_observation': observation[:0],
            'episodes': NO_EPISODES,
        }
        self._reward = reward
        if done.size:
            info = self._finish(done, up[:, done], observation, reward)
        else:
            self.episode_return += reward
            self._finished = self._none_finished
        terminated = np.zeros(self.spec.num_envs, np.bool_)
        terminated[done] = True
        truncated = np.zeros(self.spec.num_envs, np.bool_)
        return observation, reward.astype(np.float32), terminated, truncated, info

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

    def telemetry(self, rows: NDArray[np.integer]) -> Telemetry:
        """Return the physical state of the chosen rockets, with S = len(rows)."""
        thrust = self._throttle[rows] * self.settings.max_thrust
        return Telemetry(
            row=np.asarray(rows, np.int64), episode=self.episode[rows],
            time=self.age[rows] * self.settings.dt, position=self.position[:, rows].T,
            orientation=self.attitude[:, rows].T, linear_velocity=self.velocity[:, rows].T,
            angular_velocity=self.spin[:, rows].T,
            mass=self.fuel[rows] + self.settings.dry_mass, fuel=self.fuel[rows],
            throttle=self._throttle[rows], thrust=thrust, lateral_thrust=np.zeros(len(rows)),
            torque=self._torque[:, rows].T, contact_force=self._contact_force[:, rows].T,
            contact=self._touching[rows], leg_angle=np.zeros((len(rows), self.feet)),
            terrain=np.zeros((len(rows), 0)),
            reward=self._reward[rows], outcome=np.full(len(rows), NO_OUTCOME, np.uint8),
        )

    @property
    def finished(self) -> Telemetry:
        """Last states of the rockets that finished at the last step."""
        return self._finished

    def snapshot(self) -> bytes:
        """Return the exact state of all rockets."""
        return snapshots.pack(self.spec, self._state_arrays())

    def restore(self, state: bytes) -> F32:
        """Put all rockets back into a snapshot and return their observation."""
        ours = self._state_arrays()
        arrays = snapshots.unpack(self.spec, state, like=ours)
        self._check_state(arrays)
        snapshots.check_settings(self.spec, arrays.pop('settings'))
        values = dict(zip(spawn.CURRICULUM_SETTINGS, arrays.pop('curriculum').tolist(),
                          strict=True))
        try:
            settings = settings_module.build(
                self.settings_class, {**settings_module.as_dict(self._made_with), **values})
        except TypeError as error:
            raise ValueError(f'snapshot: {error}') from error
        self._apply(settings)
        self._seed = int(arrays.pop('seed')[0])
        self._load_state(arrays, ours)
        self._throttle[:] = 0
        self._torque[:] = 0
        self._touching[:] = False
        self._contact_force[:] = 0
        self._reward = np.zeros(self.spec.num_envs)
        self._finished = self._none_finished
        self._store_spawns()
        return self.observe()

    def _check_state(self, arrays: snapshots.Arrays) -> None:
        """Check values of a snapshot that no world can have.

        :raises ValueError: naming the array.
        """
        for name in ('seed', 'age', 'episode', 'fuel'):
            if (arrays[name] < 0).any():
                raise ValueError(f'snapshot: {name} has a value below 0')

    def _load_state(self, arrays: snapshots.Arrays, ours: snapshots.Arrays) -> None:
        """Copy the arrays of a snapshot into ours, those of `_state_arrays`."""
        for name, array in arrays.items():
            ours[name][...] = array

    def _state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all that the future depends on; the arrays are the world's own, not copies."""
        return {
            'position': self.position, 'velocity': self.velocity, 'attitude': self.attitude,
            'spin': self.spin, 'fuel': self.fuel, 'age': self.age, 'episode': self.episode,
            'episode_return': self.episode_return,
            'seed': np.array([self._seed], np.int64),
            'settings': np.array(list(self.spec.settings.values()), np.float64),
            'curriculum': np.array(
                [getattr(self.settings, n) for n in spawn.CURRICULUM_SETTINGS], np.float64),
        }

    def _apply(self, settings: RocketSettings) -> None:
        self.settings = settings
        self._spawn_range = spawn.spawn_range(settings)
        self._max_age = outcomes.step_limit(settings, settings.dt)
        self._cos_tilt_limit = np.cos(np.deg2rad(settings.tilt_limit))
        self._drag = (
            0.5 * settings.air_density * settings.drag_coefficient * settings.drag_area)

    def _store_spawns(self) -> None:
        """Forget the starts drawn ahead: another seed or range is in force."""
        self._spawns = spawn.SpawnStore(
            self._seed, self.spec.num_envs, self._spawn_range, self.settings, self.in_plane)

    def _begin(self, rows: NDArray[np.integer], first: spawn.Spawn) -> None:
        """Put the given rockets into their first states."""
        self.position[:, rows] = first.position
        self.velocity[:, rows] = first.velocity
        self.attitude[:, rows] = first.attitude
        self.spin[:, rows] = first.spin
        self.fuel[rows] = self.settings.fuel
        self.age[rows] = 0
        self.episode_return[rows] = 0.0
        self._throttle[rows] = 0.0
        self._torque[:, rows] = 0.0
        self._touching[rows] = False
        self._contact_force[:, rows] = 0.0

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

    def _ended(self, up_y: F64) -> NDArray[np.int64]:
        """Return the rows whose episode ended at this step, `(K,)`; keep why for `_judge`."""
        s = self.settings
        x, y, z = self.position
        self._down = y <= s.touchdown_height
        self._tilted = up_y < self._cos_tilt_limit
        self._late = self.age > self._max_age
        self._outside = (
            (y > s.height_limit) | (np.abs(x) > s.range_limit) | (np.abs(z) > s.range_limit))
        return np.flatnonzero(self._down | self._tilted | self._late | self._outside)

    def _judge(
        self, done: NDArray[np.int64], up: F64,
    ) -> tuple[NDArray[np.uint8], F64, F64, F64]:
        """Return how episodes ended: outcome, speed (m/s), tilt (deg), distance (m), `(K,)`."""
        speed = rotation.norm(self.velocity[:, done])
        # atan2 keeps its precision near upright, where arccos loses half the digits.
        tilt = np.rad2deg(np.arctan2(np.hypot(up[0], up[2]), up[1]))
        distance = np.hypot(self.position[0, done], self.position[2, done])
        outcome = np.where(
            self._down[done],
            outcomes.judge_touchdown(speed, tilt, distance, self.settings),
            outcomes.judge_flight(self._tilted[done], self._late[done], self._outside[done]))
        return outcome, speed, tilt, distance

    def _finish(
        self, done: NDArray[np.int64], up: F64, observation: F32, reward: F64,
    ) -> dict[str, Any]:
        """Pay and report the episodes that ended, and begin their rockets' next ones.

        :param up: `(3, K)` up vectors of those rockets.
        :param observation: `(N, 15)`; the rows that finished get their new first observation.
        :param reward: `(N,)`, to which the ends are added.
        """
        outcome, speed, tilt, distance = self._judge(done, up)
        reward[done] += outcomes.terminal_reward(outcome, speed, tilt, distance, self.settings)
        self.episode_return += reward
        self._finished = dataclasses.replace(self.telemetry(done), outcome=outcome)
        info = {
            'final_rows': done,
            'final_observation': observation[done],
            'episodes': Episodes(
                row=done, episode=self.episode[done],
                episode_return=self.episode_return[done], length=self.age[done],
                outcome=outcome, touchdown_speed=speed, tilt=tilt, distance=distance,
                fuel_used=self.settings.fuel - self.fuel[done],
            ),
        }
        self.episode[done] += 1
        first = self._spawns.take(done, self.episode[done])
        self._begin(done, first)
        self._reward = reward.copy()
        self._reward[done] = 0.0
        observation[done] = self._observe(done, rotation.up_vector(first.attitude))
        return info
