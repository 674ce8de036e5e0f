# SPDX-License-Identifier: Apache-2.0
"""Vehicles, air and sensors as drawn from the conditions for each episode.

All is drawn anew for each episode, as a pure function of (seed, row, episode), and of the step for
gusts and noise. So the only state to store is that of the gusts.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket.conditions import DRAWN_NAMES
from rocket_sim_node.worlds.rocket.conditions import HIGH
from rocket_sim_node.worlds.rocket.conditions import LOW
from rocket_sim_node.worlds.rocket.conditions import NOMINAL
from rocket_sim_node.worlds.rocket.conditions import RANGES
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

GUST_TIME = 2.0
"""s, time constant of gusts."""
_CONDITIONS, _GUSTS, _NOISE = 2**32 + 1, 2**32 + 2, 2**32 + 3
"""Indices of an episode's random streams; starts and headings use others."""
_NOISE_UNITS = np.repeat((0.5, 0.2, np.deg2rad(1.0)), 3)[:, None]
"""m, m/s, rad."""
_NO_TIME = 1e-300
"""s, time constant of an engine without lag."""

Rows = NDArray[np.integer]


def draw(seed: int, row: Rows, episode: Rows, settings: RocketSettings) -> F64:
    """Draw the conditions of episodes `(K,)`, each from its own random stream.

    :return: `(C, K)` in the order of `DRAWN_NAMES`.
    """
    turn = (0.0, 2 * np.pi)
    ranges = np.array([
        *([getattr(settings, name + LOW), getattr(settings, name + HIGH)] for name in RANGES),
        turn, turn])
    low, high = ranges.T[:, :, None]
    part = (random_streams.uniform(seed, row, episode, len(DRAWN_NAMES), _CONDITIONS) + 1.0) / 2
    kept = part < settings.nominal_share
    kept[len(RANGES):] = False
    if settings.nominal_share:
        part[:len(RANGES)] -= settings.nominal_share
        part[:len(RANGES)] /= 1.0 - settings.nominal_share
    drawn: F64 = low + (high - low) * part
    delay = DRAWN_NAMES.index('action_delay')
    drawn[delay] = np.floor(low[delay] + (high[delay] + 1 - low[delay]) * part[delay])
    np.minimum(drawn, high, out=drawn)
    np.copyto(drawn, NOMINAL[:, None], where=kept)
    return drawn


class DrawnVehicles:
    """Drawn properties of N vehicles; all arrays are `(N,)` unless a shape is given.

    `drawn` `(C, N)` conditions in the order of `DRAWN_NAMES`; `dry_mass` and `fuel` at spawn in
    kg; `max_thrust` N; `burn` kg used at full throttle and `fall` m/s gained by gravity in an
    integration step; `rcs_torque` N m; `drag` kg/m; `lag_kept`, the part of an engine's lag that
    remains after a step; `floor`, the minimum throttle; `side` `(2, N)` m/s^2 and `wind` `(3, N)`
    m/s.
    """

    def __init__(
        self, num_envs: int, seed: int, settings: RocketSettings, in_plane: bool,
    ) -> None:
        """Store the settings; vehicles are nominal until `begin`.

        :param in_plane: omit everything that leads out of the x-y plane.
        """
        s = self._settings = settings
        self._seed, self._in_plane = seed, in_plane
        self.nominal = conditions.name_of(vars(s)) == 'nominal'
        self.windy, self.noisy = s.wind_speed_high > 0, s.sensor_noise_high > 0
        self.gusty, self.delayed = s.gust_deviation_high > 0, s.action_delay_high > 0
        self.disturbed = self.gusty or s.side_acceleration_high > 0
        self.lagged, self.floored = s.engine_lag_high > 0, s.throttle_floor_high > 0
        self._gust_kept = np.exp(-s.dt / GUST_TIME)
        self.drawn = np.tile(NOMINAL[:, None], num_envs)
        self._made = self._make(self.drawn)
        (self.dry_mass, self.fuel, self.max_thrust, self.burn, self.rcs_torque, self.drag,
         self.fall, self.lag_kept, self.floor) = self._made[:9]
        self.side, self.wind = self._made[9:11], self._made[11:14]
        self._keys = np.zeros((2, num_envs), np.uint64)
        self._ahead = None if self.nominal else random_streams.DrawnAhead(num_envs, self._draw)

    def _draw(
        self, row: Rows, episode: Rows,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]:
        """Return conditions `(K, C)`, derived values `(K, M)`, stream keys `(K, 2)`."""
        row = row // self._settings.spawn_copies
        drawn = draw(self._seed, row, episode, self._settings)
        keys = [random_streams.keys(self._seed, row, episode, s) for s in (_GUSTS, _NOISE)]
        return drawn.T, self._make(drawn).T, np.stack(keys, axis=1)

    def _make(self, drawn: F64) -> F64:
        """Return the values derived from conditions `(C, K)`, `(M, K)`."""
        s, value = self._settings, dict(zip(DRAWN_NAMES, drawn, strict=True))
        dt = s.dt / s.substeps
        thrust = s.max_thrust * value['thrust_factor']
        exhaust = s.specific_impulse * value['isp_factor'] * s.gravity
        flow = thrust / exhaust if s.gravity else np.zeros_like(thrust)
        depth = 0.0 if self._in_plane else 1.0
        side, wind = (
            (speed * np.cos(direction), speed * np.sin(direction) * depth)
            for speed, direction in (
                (value['side_acceleration'], value['side_direction']),
                (value['wind_speed'], value['wind_direction'])))
        return np.array([
            s.dry_mass * value['dry_mass_factor'], s.fuel * value['fuel_factor'], thrust,
            flow * dt, s.rcs_torque * value['rcs_factor'],
            0.5 * (s.air_density * value['air_density_factor']) * s.drag_coefficient
            * s.drag_area, s.gravity * value['gravity_factor'] * dt,
            np.exp(-s.dt / np.maximum(value['engine_lag'], _NO_TIME)), value['throttle_floor'],
            *side, wind[0], np.zeros_like(thrust), wind[1]])

    def begin(self, rows: Rows, episodes: Rows) -> None:
        """Draw the vehicles for episodes `(K,)` of rockets `(K,)`."""
        if self._ahead is not None:
            drawn, made, keys = self._ahead.take(rows, episodes)
            self.drawn[:, rows], self._made[:, rows], self._keys[:, rows] = drawn.T, made.T, keys.T

    @property
    def delay(self) -> NDArray[np.int64]:
        """Delay of commands, in steps."""
        steps: F64 = self.drawn[DRAWN_NAMES.index('action_delay')]
        return steps.astype(np.int64)

    def first_gust(self, rows: Rows) -> F64:
        """Return initial gusts `(2, K)` m/s^2, from the stationary distribution."""
        return self._shock(rows, np.zeros(len(rows), np.int64))

    def next_gust(self, gust: F64, age: Rows) -> F64:
        """Return the gusts `(2, N)` m/s^2 one step later, at `age` `(N,)` steps.

        A stationary Ornstein-Uhlenbeck process at steps of dt, exactly: Gillespie, 'Exact
        numerical simulation of the Ornstein-Uhlenbeck process', Physical Review E 54, 1996,
        equation 3.1.
        """
        kept = self._gust_kept
        later: F64 = kept * gust + np.sqrt(1.0 - kept * kept) * self._shock(slice(None), age)
        return later

    def _shock(self, rows: Rows | slice, age: Rows) -> F64:
        shock = random_streams.normal(self._keys[0, rows], 2, age)
        shock *= self.drawn[DRAWN_NAMES.index('gust_deviation'), rows]
        if self._in_plane:
            shock[1] = 0.0
        return shock

    def sense(
        self, rows: Rows | slice, age: Rows, position: F64, velocity: F64, up: F64,
    ) -> tuple[F64, F64, F64]:
        """Return measured position, velocity and up vector, `(3, K)` each.

        :param age: `(K,)` steps since the episodes began; the noise is that of this step.
        """
        noise = random_streams.normal(self._keys[1, rows], 9, age) * _NOISE_UNITS
        noise *= self.drawn[DRAWN_NAMES.index('sensor_noise'), rows]
        if self._in_plane:
            noise[2::3] = 0.0
        leaning = up + noise[6:9]
        leaning /= rotation.norm(leaning)
        return position + noise[0:3], velocity + noise[3:6], leaning
