# SPDX-License-Identifier: Apache-2.0
"""World `rocket`: powered landing in three dimensions, N rockets as one batch."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import settings as settings_module
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket import outcome as outcomes
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket import spawn
from rocket_sim_node.worlds.rocket.actuators import IDLE
from rocket_sim_node.worlds.rocket.dynamics import ACTION_NAMES
from rocket_sim_node.worlds.rocket.dynamics import RocketDynamics
from rocket_sim_node.worlds.rocket.dynamics import observation_names
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

_UNIT = 1e-6
"""Tolerance for the length of an attitude quaternion."""


class RocketWorld(RocketDynamics):
    """N rockets that fall towards a pad at the origin and have one burn to stop. A `VectorEnv`.

    :class:`RocketDynamics` moves them; this class handles episodes. Variants of the world derive
    from it.
    """

    name = 'rocket'
    settings_class: type[RocketSettings] = RocketSettings
    settings: RocketSettings
    reset_settings: tuple[str, ...] = (*spawn.CURRICULUM_SETTINGS, *conditions.FLAT_NAMES)
    """Settings that a reset may change."""

    def __init__(self, num_envs: int = 1, seed: int = 0, **settings: Any) -> None:
        """Create the world and begin the first episodes.

        :raises ValueError: for a setting that is unknown or out of range.
        """
        self._made_with = settings_module.build(
            self.settings_class, conditions.flatten(settings))
        super().__init__(num_envs, self._made_with, seed)
        self.episode_return = np.zeros(num_envs)
        self._none_finished = self._finished = self.capture(self.rows[:0])
        self.spec = WorldSpec(
            name=self.name, num_envs=num_envs, dt=self.settings.dt,
            observation_names=observation_names(self.settings), action_names=ACTION_NAMES,
            continuous=True, action_low=(-1.0,) * 3, action_high=(1.0,) * 3,
            action_idle=IDLE, action_count=0,
            outcomes=outcomes.OUTCOMES, settings=settings_module.as_numbers(self._made_with),
            condition_names=conditions.DRAWN_NAMES,
        )
        self.reset(seed)

    def reset(self, seed: int | None = None, **settings: Any) -> F32:
        """Start new episodes of all rockets; see :class:`VectorEnv`.

        Conditions may be given in any form that `conditions.flatten` takes.
        """
        checked = settings_module.changed(
            self._made_with, conditions.flatten(settings), self.reset_settings)
        if seed is not None:
            seed = random_streams.check_seed(seed)
        new_seed, episode = (
            (self._seed, self.episode + 1) if seed is None
            else (seed, np.zeros_like(self.episode)))
        first = spawn.draw(
            new_seed, self.rows, episode, spawn.spawn_range(checked), checked, self.in_plane)
        self._use(checked, new_seed)
        self.episode = episode
        # If the new conditions have no gusts, nothing else would clear those of the old ones.
        self.gust[:] = 0.0
        self.disturbance[:] = 0.0
        self._begin(self.rows, first)
        self.reward = np.zeros(self.spec.num_envs)
        self._finished = self._none_finished
        return self.observe()

    @property
    def flown_settings(self) -> dict[str, float]:
        """The settings of `spec` with those that the last reset or restore gave in their place."""
        return {**self.spec.settings, **settings_module.as_numbers(self.settings)}

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by `dt`; see :class:`VectorEnv`."""
        return self.step_checked(checked_action(self.spec, action))

    def step_checked(
        self, command: NDArray[Any],
    ) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by `dt`, with actions that `checked_action` has returned."""
        self.log.note_command(command)
        before = self.velocity.copy() if self.extended else None
        self._advance(self.line.push(command, self.vehicles))
        self.age += 1
        if self.vehicles.gusty:
            self.gust[:] = self.vehicles.next_gust(self.gust, self.age)
        if before is not None:
            self.accelerations[1:] = self.accelerations[:-1]
            self.accelerations[0] = (self.velocity - before) / self.settings.dt
        up = rotation.up_vector(self.attitude)
        observation = self._observe(self._all, up)
        done = self._ended(up[1])
        reward = np.full(self.spec.num_envs, self.settings.reward_step)
        info: dict[str, Any] = {
            'final_rows': done, 'final_observation': observation[:0],
            'episodes': NO_EPISODES,
        }
        self.reward = reward
        if done.size:
            info = self._finish(done, up[:, done], observation, reward)
        else:
            self.episode_return += reward
            self._finished = self._none_finished
        terminated = np.zeros(self.spec.num_envs, np.bool_)
        terminated[done] = True
        truncated = np.zeros(self.spec.num_envs, np.bool_)
        return observation, reward.astype(np.float32), terminated, truncated, info

    def snapshot(self) -> bytes:
        """Return the exact state of all rockets."""
        return snapshots.pack(self.spec, self._state_arrays())

    def restore(self, state: bytes) -> F32:
        """Restore all rockets from a snapshot and return their observation."""
        ours = self._state_arrays()
        arrays = snapshots.unpack(
            self.spec, state, like=ours, any_length=('commands',),
            before=snapshots.zeros(self._last_step()))
        snapshots.check_settings(self.spec.settings, arrays.pop('settings'))
        values = dict(zip(self.reset_settings, arrays.pop('curriculum').tolist(), strict=True))
        try:
            settings = settings_module.changed(self._made_with, values, self.reset_settings)
        except (TypeError, ValueError) as error:
            raise ValueError(f'snapshot: {error}') from error
        self._check_state(arrays, settings)
        try:
            self._use(settings, int(arrays.pop('seed')[0]))
        except ValueError as error:
            raise ValueError(f'snapshot: {error}') from error
        self._load_state(arrays, self._state_arrays())
        self.vehicles.begin(self.rows, self.episode)
        self._finished = self._none_finished
        return self.observe()

    def _check_state(self, arrays: snapshots.Arrays, settings: RocketSettings) -> None:
        """Check for values of a snapshot that no world with these settings can have.

        :raises ValueError: naming the array.
        """
        snapshots.check_counts(arrays, 'seed', 'age', 'episode', 'ignitions', 'hover')
        snapshots.check_range(arrays, -1.0, 1.0, 'commands', 'commanded')
        snapshots.check_range(arrays, 0.0, 1.0, 'throttle')
        length = self._line_length(settings)
        if len(arrays['commands']) != length:
            raise ValueError(
                f"snapshot: commands has {len(arrays['commands'])} steps, expected {length}")
        if (arrays['fuel'] < 0).any():
            raise ValueError('snapshot: fuel has a value below 0')
        if (np.abs(rotation.norm(arrays['attitude']) - 1.0) > _UNIT).any():
            raise ValueError('snapshot: attitude has a quaternion that is not of length 1')

    def _load_state(self, arrays: snapshots.Arrays, ours: snapshots.Arrays) -> None:
        """Copy the arrays of a snapshot into ours, those of `_state_arrays`."""
        for name, array in arrays.items():
            ours[name][...] = array

    def _state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the complete state; the arrays are the world's own, not copies."""
        return {
            'position': self.position, 'velocity': self.velocity, 'attitude': self.attitude,
            'spin': self.spin, 'fuel': self.fuel, 'age': self.age, 'episode': self.episode,
            'episode_return': self.episode_return, 'gust': self.gust,
            'throttle': self.engines.throttle, 'lit': self.engines.lit,
            'ignitions': self.engines.ignitions, 'hover': self.log.hover,
            'effort': self.log.effort, 'commanded': self.log.commanded,
            'commands': self.line.commands, 'accelerations': self.accelerations,
            'seed': np.array([self._seed], np.int64),
            'settings': np.array(list(self.spec.settings.values()), np.float64),
            'curriculum': np.array(
                [getattr(self.settings, name) for name in self.reset_settings], np.float64),
            **self._last_step(),
        }

    def _last_step(self) -> dict[str, NDArray[Any]]:
        """Return results of the last step that only telemetry needs; older snapshots lack them."""
        return {
            'torque': self.torque, 'disturbance': self.disturbance, 'reward': self.reward,
            'touching': self._touching, 'contact_force': self.contact_force}

    def _use(self, settings: RocketSettings, seed: int) -> None:
        """Apply settings and a seed; episodes must be started or loaded afterwards.

        :raises ValueError: when they allow no spawn; then nothing has changed.
        """
        spawn_range = spawn.spawn_range(settings)
        super()._use(settings, seed)
        self._spawns = spawn.SpawnStore(
            seed, len(self.rows), spawn_range, settings, self.in_plane)
        self._max_age = outcomes.step_limit(settings, settings.dt)
        self._cos_tilt_limit = np.cos(np.deg2rad(settings.tilt_limit))

    def _begin(self, rows: NDArray[np.integer], first: spawn.Spawn) -> None:
        """Set the given rockets to their initial states."""
        self.vehicles.begin(rows, self.episode[rows])
        self.position[:, rows] = first.position
        self.velocity[:, rows] = first.velocity
        self.attitude[:, rows] = first.attitude
        self.spin[:, rows] = first.spin
        self.fuel[rows] = self.vehicles.fuel[rows]
        self.line.begin(rows)
        self.engines.begin(rows)
        self.log.begin(rows)
        self.age[rows] = 0
        self.episode_return[rows] = 0.0
        self.torque[:, rows] = 0.0
        self._touching[rows] = False
        self.contact_force[:, rows] = 0.0
        if self.vehicles.gusty:
            self.gust[:, rows] = self.vehicles.first_gust(rows)
        if self.vehicles.disturbed:
            self.disturbance[::2, rows] = self.vehicles.side[:, rows] + self.gust[:, rows]
        if self.extended:
            self.accelerations[:, :, rows] = 0.0

    def _ended(self, up_y: F64) -> NDArray[np.int64]:
        """Return the rows whose episode ended at this step, `(K,)`; keep reasons for `_judge`."""
        s = self.settings
        x, y, z = self.position
        self._down = y <= s.touchdown_height
        self._tilted = up_y < self._cos_tilt_limit
        self._late = self.age > self._max_age
        self._outside = (
            (y > s.height_limit) | (np.abs(x) > s.range_limit) | (np.abs(z) > s.range_limit))
        rows: NDArray[np.int64] = (
            self._down | self._tilted | self._late | self._outside).nonzero()[0]
        return rows

    def _judge(
        self, done: NDArray[np.int64], up: F64,
    ) -> tuple[NDArray[np.uint8], F64, F64, F64]:
        """Return outcome, speed (m/s), tilt (deg) and distance (m) of ended episodes, `(K,)`."""
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
        """Reward and report the ended episodes, and begin the next ones of their rockets.

        :param up: `(3, K)` up vectors of those rockets.
        :param observation: `(N, D)`; rows that finished get their new first observation.
        :param reward: `(N,)`; terminal rewards are added to it.
        """
        outcome, speed, tilt, distance = self._judge(done, up)
        reward[done] += outcomes.terminal_reward(outcome, speed, tilt, distance, self.settings)
        self.episode_return += reward
        self._capture_ends(done, outcome)
        info = {
            'final_rows': done,
            'final_observation': observation[done],
            'episodes': Episodes(
                row=done, episode=self.episode[done],
                episode_return=self.episode_return[done], length=self.age[done],
                outcome=outcome, touchdown_speed=speed, tilt=np.deg2rad(tilt), distance=distance,
                fuel_used=self.vehicles.fuel[done] - self.fuel[done], fuel_left=self.fuel[done],
                hover_time=self.log.hover_time(done, self.settings.dt),
                ignitions=self.engines.ignitions[done],
                control_effort=self.log.mean_effort(done, self.age[done]),
            ),
        }
        self.episode[done] += 1
        first = self._spawns.take(done, self.episode[done])
        self._begin(done, first)
        self.reward = reward.copy()
        self.reward[done] = 0.0
        observation[done] = self._observe(done, rotation.up_vector(first.attitude))
        return info
