# SPDX-License-Identifier: Apache-2.0
"""World `lunar_lander`: Gymnasium's LunarLander-v3 on pymunk, N landers as one batch.

Numbers, rewards and rules follow Gymnasium's documentation and source (Farama Foundation, version
1.4, `envs/box2d/lunar_lander.py`). x = 0 is the middle of the pad; y is Gymnasium's, 0 at the
floor.
"""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import settings as settings_module
from rocket_sim_node.telemetry.capture import StateCapture
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.lunar import spawn
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar import view
from rocket_sim_node.worlds.lunar.engines import Engines
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings
from rocket_sim_node.worlds.pymunk_batch.lane_block import Solver
from rocket_sim_node.worlds.pymunk_batch.lanes import Lanes

OUTCOMES = ('landed', 'crashed', 'out_of_bounds', 'timeout')
LANDED, CRASHED, OUT_OF_BOUNDS, TIMEOUT = range(4)

_TOLERANCE = 1e-9
"""s, for the rounding of a sum of steps."""
_SOLVER = Solver(iterations=15, slop=0.005, bias=(1 - 0.2) ** 50)


class LunarLanderWorld(StateCapture):
    """N landers that fall towards a pad between slopes. A `SimulatedWorld`.

    Row k of every array is lander k.
    """

    reset_settings: ClassVar[tuple[str, ...]] = ('spawn_reach',)
    added: ClassVar[Mapping[str, float]] = {'spawn_reach': 0.0}
    """Settings that older versions do not have, with the value at which nothing changes."""
    captured: ClassVar[Mapping[str, str]] = {
        'age': 'age', 'main': '_main', 'side': '_side', 'pose': '_poses',
        'velocity': '_hull_motion', 'ground_force': '_contact_force.T',
        'touching': '_touching.T', 'heights': 'terrain.T'}

    def __init__(
        self, num_envs: int = 1, seed: int = 0, step_threads: int = 1, **settings: float,
    ) -> None:
        """Create the world and begin the first episodes.

        :param step_threads: threads that step the landers; the results are the same bits.
        :raises ValueError: for a setting that is unknown or out of range.
        """
        self._made_with = self.settings = s = settings_module.build(LunarSettings, settings)
        # An episode ends after a step, so it has at least one.
        self._step_limit = max(1, int(np.floor(s.time_limit / s.dt + 1e-9)))
        rest = max(1, int(np.ceil((s.rest_time - _TOLERANCE) / s.dt)))
        if rest > self._step_limit:
            raise ValueError(
                f"setting 'rest_time': got {s.rest_time}, which takes {rest} steps of {s.dt} s, "
                f'expected at most the {self._step_limit} of time_limit, {s.time_limit} s')
        self._rest_speed_squared, self._rest_spin = s.rest_speed**2, np.deg2rad(s.rest_spin)
        self._lanes = Lanes(
            num_envs, vehicle.LunarDesign(), s.dt, s.gravity, _SOLVER, step_threads)
        self._engines = Engines(s)
        self._force = np.zeros((num_envs, 3, 3))
        self._sin, self._cos = np.zeros(num_envs), np.ones(num_envs)
        """Of the hulls' angles."""
        self.rows = np.arange(num_envs)
        self._all = slice(None)
        self._seed = seed
        self.terrain = np.zeros((num_envs, vehicle.LunarDesign.slopes + 1))
        self._shaping = np.zeros(num_envs)
        self._still = np.zeros(num_envs)
        self._touching = np.zeros((num_envs, 3), np.bool_)
        self._contact_force = np.zeros((num_envs, 2))
        self._wind = np.zeros((2, num_envs))
        # Result of the last step, for telemetry only.
        self.disturbance = np.zeros((3, num_envs))
        self._keys = np.zeros(num_envs, np.uint64)
        self.age = np.zeros(num_envs, np.int64)
        self.episode = np.zeros(num_envs, np.int64)
        self.episode_return = np.zeros(num_envs)
        self._main, self._side = np.zeros(num_envs), np.zeros(num_envs)
        self.reward = np.zeros(num_envs)
        self.no_outcome = np.full(num_envs, NO_OUTCOME, np.uint8)
        self.spec = WorldSpec(
            name='lunar_lander', num_envs=num_envs, dt=s.dt,
            observation_names=view.OBSERVATION_NAMES,
            action_names=('main', 'lateral') if s.continuous else ('engine',),
            continuous=s.continuous,
            action_low=(-1.0, -1.0) if s.continuous else (),
            action_high=(1.0, 1.0) if s.continuous else (),
            action_idle=(-1.0, 0.0) if s.continuous else (0.0,),
            action_count=0 if s.continuous else 4, outcomes=OUTCOMES,
            settings={
                **settings_module.as_dict(s), 'field_half_width': vehicle.HALF_WIDTH,
                'max_thrust': self._engines.max_thrust},
        )
        self._none_finished = self._finished = self.capture(self.rows[:0])
        self.reset(seed)

    def reset(self, seed: int | None = None, **settings: float) -> F32:
        """Start new episodes of all landers; see :class:`VectorEnv`."""
        checked = settings_module.changed(self._made_with, settings, self.reset_settings)
        if seed is None:
            self.episode += 1
        else:
            self._seed = random_streams.check_seed(seed)
            self.episode[:] = 0
        self.settings = checked
        self._starts = self._make_starts()
        self.reward[:] = 0
        self._finished = self._none_finished
        return self._begin(self.rows)

    @property
    def flown_settings(self) -> dict[str, float]:
        """The settings of `spec` with those that the last reset or restore gave in their place."""
        return {**self.spec.settings, **settings_module.as_dict(self.settings)}

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all landers by `dt`; see :class:`VectorEnv`."""
        return self.step_checked(checked_action(self.spec, action))

    def step_checked(
        self, command: NDArray[Any],
    ) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all landers by `dt`, with actions that `checked_action` has returned."""
        self._advance(command)
        observation, shaping = self._look(self._all)
        s = self.settings
        reward = shaping - self._shaping
        self._shaping = shaping
        reward += s.reward_main_engine * self._main
        reward += s.reward_side_engine * np.abs(self._side)
        crashed = self._touching[:, 0]
        outside = np.abs(observation[:, 0]) >= 1.0
        rest = (self._still > 0) & (self._still >= s.rest_time - _TOLERANCE)
        if rest.any():
            rest &= self._touching.any(1)  # without gravity, or hovering, it may be in the air
        terminated = crashed | outside | rest
        if terminated.any():
            # In this order: a lander at rest has landed, whatever touches.
            reward[terminated] = s.reward_crash
            reward[rest] = s.reward_landed
        truncated = (self.age >= self._step_limit) & ~terminated
        done = (terminated | truncated).nonzero()[0]
        self.episode_return += reward
        self.reward = reward
        self._finished = self._none_finished
        info: dict[str, Any] = {
            'final_rows': done, 'final_observation': observation[:0], 'episodes': NO_EPISODES}
        if done.size:
            outcome = np.full(len(done), TIMEOUT, np.uint8)
            outcome[outside[done]] = OUT_OF_BOUNDS
            outcome[crashed[done]] = CRASHED
            outcome[rest[done]] = LANDED
            info = self._finish(done, outcome, observation)
        return observation, reward.astype(np.float32), terminated, truncated, info

    def _advance(self, command: NDArray[Any]) -> None:
        """Integrate one step and record contacts."""
        lanes, s = self._lanes, self.settings
        force = self._force
        scatter = random_streams.numbers(self._keys, 2, spawn.DRAWS + 2 * self.age)
        self._main, self._side = self._engines.throttles(command)
        self._engines.push(
            self._sin, self._cos, self._main, self._side, scatter, force[:, 0])
        if s.enable_wind:
            self._blow(force[:, 0])
        lanes.step(force)
        self.age += 1
        self._touching[:] = False
        self._contact_force[:] = 0.0
        touch = lanes.contacts
        if len(touch.row):
            self._touching[touch.row, touch.body] = True
            np.add.at(self._contact_force, touch.row, touch.impulse / s.dt)
        velocity = lanes.velocity
        still = (
            (velocity[:, :, 0]**2 + velocity[:, :, 1]**2 <= self._rest_speed_squared)
            & (np.abs(velocity[:, :, 2]) <= self._rest_spin)).all(1)
        self._still = np.where(still, self._still + s.dt, 0.0)

    def _blow(self, force: F64) -> None:
        """Add wind and turbulence to the forces `(N, 3)`: tanh(sin 2kx + sin pi kx), k = 0.01.

        As in Gymnasium, the wind pushes the hull's own centre of gravity, which is not that of its
        body here.
        """
        blown = np.flatnonzero(~self._touching[:, 1:].any(1))
        place = 0.01 * self._wind[:, blown]
        strength = np.tanh(np.sin(2 * place) + np.sin(np.pi * place))
        push = strength[0] * self.settings.wind_power
        lever = (vehicle.HULL_CENTRE - vehicle.BODY_CENTRE) * self._cos[blown]
        self.disturbance[0] = 0.0
        self.disturbance[0, blown] = push / vehicle.TOTAL_MASS
        force[blown, 0] += push
        force[blown, 2] += strength[1] * self.settings.turbulence_power - push * lever
        self._wind[:, blown] += 1

    def observe(self) -> F32:
        """Return the observation `(N, 8)` of the current state."""
        return self._look(self._all)[0]

    def _look(self, rows: NDArray[np.int64] | slice) -> tuple[F32, F64]:
        """Return observations `(K, 8)` and the shaping potential `(K,)`.

        It must be called whenever poses have changed.
        """
        pose = self._lanes.pose[rows, 0]
        sin, cos = np.sin(pose[:, 2]), np.cos(pose[:, 2])
        self._sin[rows], self._cos[rows] = sin, cos
        return view.observe(
            pose, self._lanes.velocity[rows, 0], self._touching[rows], sin, cos)

    # Episodes

    def _make_starts(self) -> spawn.Starts:
        return spawn.Starts(
            self._seed, self.spec.num_envs, self.settings.dt, self.settings.gravity,
            self.settings.spawn_reach)

    def _begin(self, rows: NDArray[np.int64]) -> F32:
        """Place landers at the start of their episodes; return their observations `(K, 8)`."""
        start = self._starts.take(rows, self.episode[rows])
        self.terrain[rows] = start.terrain
        for row in rows.tolist():
            spawn.shape_ground(self._lanes, row, self.terrain[row])
        self._lanes.place(rows, start.pose, start.velocity)
        self._wind[:, rows] = start.wind
        self._keys[rows] = start.key
        for array in (self.age, self._still, self.episode_return, self._main, self._side):
            array[rows] = 0
        self._touching[rows] = False
        self._contact_force[rows] = 0.0
        self.disturbance[0, rows] = 0.0
        observation, self._shaping[rows] = self._look(rows)
        return observation

    def _finish(
        self, done: NDArray[np.int64], outcome: NDArray[np.uint8], observation: F32,
    ) -> dict[str, Any]:
        """Report the ended episodes, and begin the next ones of their landers.

        :param observation: `(N, 8)`; rows that finished get their new first observation.
        """
        self._capture_ends(done, outcome)
        x, _ = view.hull_origin(self._lanes.pose[done, 0])
        speed_x, speed_y = view.hull_velocity(
            self._lanes.pose[done, 0], self._lanes.velocity[done, 0], vehicle.HULL_CENTRE)
        info = {
            'final_rows': done, 'final_observation': observation[done],
            'episodes': Episodes(
                row=done, episode=self.episode[done],
                episode_return=self.episode_return[done], length=self.age[done],
                outcome=outcome, touchdown_speed=np.hypot(speed_x, speed_y),
                tilt=view.tilt(self._lanes.pose[done, 0]), distance=np.abs(x),
                fuel_used=(none := np.zeros(len(done))), fuel_left=none, hover_time=none,
                ignitions=none.astype(np.int64), control_effort=none,
            ),
        }
        self.episode[done] += 1
        observation[done] = self._begin(done)
        self.reward = self.reward.copy()
        self.reward[done] = 0.0
        return info

    @property
    def _poses(self) -> F64:
        """Poses of hull, left and right leg, `(9, N)`."""
        return self._lanes.pose.reshape(-1, 9).T

    @property
    def _hull_motion(self) -> F64:
        """Velocities of the hulls' bodies, `(3, N)`."""
        return self._lanes.velocity[:, 0].T

    def _derived(self, known: Mapping[str, F64]) -> dict[str, NDArray[Any]]:
        return view.telemetry(known, self._engines) | {'time': known['age'] * self.settings.dt}

    # Snapshots

    def snapshot(self) -> bytes:
        """Return the exact state; clears the contact solver's memory, as `restore` does."""
        self._lanes.forget()
        return snapshots.pack(self.spec, self._state_arrays())

    def restore(self, state: bytes) -> F32:
        """Restore all landers from a snapshot and return their observation."""
        ours = self._state_arrays()
        arrays = snapshots.unpack(
            self.spec, state, like=ours,
            before={**snapshots.zeros(self._last_step()),
                    **{name: np.array([value]) for name, value in self.added.items()}})
        snapshots.check_settings(_unchanging(self.spec.settings), arrays.pop('settings'))
        reach = float(arrays.pop('spawn_reach')[0])
        try:
            settings = settings_module.changed(
                self._made_with, {'spawn_reach': reach}, self.reset_settings)
        except ValueError as error:
            raise ValueError(f'snapshot: {error}') from error
        snapshots.check_counts(arrays, 'seed', 'age', 'episode', 'still')
        bodies = {
            name.removeprefix('lanes_'): arrays.pop(name)
            for name in list(arrays) if name.startswith('lanes_')}
        self._lanes.check(**bodies)
        self._lanes.load(**bodies)
        self.settings = settings
        self._seed = int(arrays.pop('seed')[0])
        for name, array in arrays.items():
            ours[name][...] = array
        self._starts = self._make_starts()
        start = self._starts.take(self.rows, self.episode)
        self.terrain, self._keys = start.terrain, start.key
        for row in self.rows.tolist():
            spawn.shape_ground(self._lanes, row, self.terrain[row])
        self._finished = self._none_finished
        return self.observe()

    def _state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the complete state; the arrays are the world's own, except `lanes_`."""
        return {
            'shaping': self._shaping, 'still': self._still,
            'touching': self._touching, 'wind': self._wind, 'age': self.age,
            'episode': self.episode, 'episode_return': self.episode_return,
            'seed': np.array([self._seed], np.int64),
            'settings': np.array(list(_unchanging(self.spec.settings).values()), np.float64),
            'spawn_reach': np.array([self.settings.spawn_reach]),
            **{f'lanes_{name}': array for name, array in self._lanes.arrays().items()},
            **self._last_step(),
        }

    def _last_step(self) -> dict[str, NDArray[Any]]:
        """Return results of the last step that only telemetry needs; older snapshots lack them."""
        return {
            'main': self._main, 'side': self._side, 'reward': self.reward,
            'contact_force': self._contact_force, 'disturbance': self.disturbance}


def _unchanging(settings: Mapping[str, float]) -> dict[str, float]:
    """Return the settings that no reset changes."""
    return {name: value for name, value in settings.items()
            if name not in LunarLanderWorld.reset_settings}
