# SPDX-License-Identifier: Apache-2.0
"""Human pilot: converts keys and their timing to actions.

The throttle keeps its setting; space is full throttle while held. Arrow keys tilt the vehicle:
with assist, an attitude loop holds the requested tilt, or upright without a key; without assist,
they fire the attitude control directly. The timing of the burn is left to the person.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.expert.attitude import attitude_torque
from ppo_agent_node.pilots.keys import HeldKeys
from ppo_agent_node.pilots.keys import KeyEvent
from ppo_agent_node.pilots.keys import Motion
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import WorldSpec

_ALIASES = {'a': 'left', 'd': 'right'}
_OPPOSITE = {'left': 'right', 'right': 'left', 'up': 'down', 'down': 'up'}
_TAP = 0.1
"""s that a thruster fires after a press, without assist."""
_ATTITUDE_RATE = 6.0
"""rad/s, natural frequency of the attitude loop, critically damped: fast, but humanly so."""
_BRAKE_SHARE = 0.67
"""Share of the attitude control available to stop a turn."""
_LEANS = {False: 8.0, True: 17.0}
"""deg, of rockets and of the lander."""
_NOTHING, _LEFT, _MAIN, _RIGHT = range(4)
_LEAST_COMMAND = 1e-6
"""Command at which the main engine of a lander with continuous actions fires at 50 %."""
_TURN_WANTED, _TURN_NEEDED = 0.05, 0.15
"""Thresholds of the lander's attitude error: to fire a side engine; to pause the main engine."""


@dataclass(frozen=True)
class StartSettings:
    """Where flights by hand begin."""

    seed: int = setting(0, '', 'seed of the first start; each flight uses the next one', 0, 2**62)
    level: int = setting(
        1, '', "curriculum level of the starts; rocket worlds only; 0: the simulator's own", 0, 8)


@dataclass(frozen=True)
class KeyboardSettings:
    """Handling of keys."""

    assist: bool = setting(
        True, '', 'whether arrow keys command a lean, which an autopilot holds; false: they fire '
        'the attitude control directly')
    lean: float = setting(
        0.0, 'deg', "lean commanded by an arrow key; 0: the world's default", 0.0, 40.0)
    attitude_share: float = setting(
        0.25, '', 'fraction of the attitude control that an arrow key fires without assist; '
        'rocket worlds only', 0.01, 1.0)
    throttle_step: int = setting(5, '%', 'change of the throttle per press of w or s', 1, 50)
    repeat_delay: float = setting(
        0.6, 's', "time for which a press counts as held if the terminal reports no release; "
        "longer than the keyboard's repeat delay", 0.05, 2.0)
    repeat_gap: float = setting(
        0.12, 's', "time for which a repeat counts as held; longer than the keyboard's repeat "
        'interval', 0.02, 1.0)


class KeyboardPilot:
    """Flies all vehicles of a batch alike, by the keys of one person."""

    name = 'keyboard'

    def __init__(self, spec: WorldSpec, settings: KeyboardSettings | None = None) -> None:
        """Set up the controls of a world, engine off.

        :raises ValueError: for a world without keyboard controls.
        """
        self._spec, self.settings = spec, settings or KeyboardSettings()
        self._lander = spec.name == 'lunar_lander'
        if not self._lander and spec.action_names != ('throttle', 'rcs_x', 'rcs_z'):
            raise ValueError(
                f'keyboard: world {spec.name!r}, expected one of rocket, rocket_planar, '
                'lunar_lander')
        self._lean = np.deg2rad(self.settings.lean or _LEANS[self._lander])
        self._keys = HeldKeys(self.settings.repeat_delay, self.settings.repeat_gap)
        self._percent = 0
        self._owed = 0.0
        """Accumulated throttle of the lander's main engine, which has a minimum; see `_pulse`."""

    def reset(self) -> None:
        """Reset all keys to up and the engine to off, for a new flight."""
        self._percent = 0
        self._owed = 0.0
        self._keys.clear()

    def know_releases(self) -> None:
        """Rely on the terminal to report each key release from now on."""
        self._keys.know_releases()

    def press(self, event: KeyEvent, now: float) -> bool:
        """Handle a key; return whether it is a control.

        :param now: s, from a monotonic clock.
        """
        key = _ALIASES.get(event.key, event.key)
        down = event.motion is not Motion.RELEASE
        throttle = key in ('w', 's', 'x', 'z') or (key.isdecimal() and key.isascii())
        if not throttle and key not in ('space', *_OPPOSITE):
            return False
        if down and key in _OPPOSITE:
            self._keys.release(_OPPOSITE[key])
        if down and throttle:
            self._set_throttle(key)
            # Setting the throttle implies that space is released.
            self._keys.release('space')
        short = key in _OPPOSITE and not self.settings.assist
        self._keys.move(KeyEvent(key, event.motion), now, _TAP if short else None)
        return True

    def _set_throttle(self, key: str) -> None:
        step = self.settings.throttle_step
        self._percent = {
            'w': min(self._percent + step, 100), 's': max(self._percent - step, 0),
            'x': 0, 'z': 100,
        }.get(key, self._percent)
        if key.isdecimal():
            self._percent = 10 * int(key)

    def throttle(self, now: float) -> float:
        """Return the throttle, 0 to 1."""
        return 1.0 if self._keys.held('space', now) else self._percent / 100

    def sideways(self, now: float) -> tuple[int, int]:
        """Return the direction along x and z: -1 (left; away), 0 or 1 (right; nearer)."""
        x = self._keys.held('right', now) - self._keys.held('left', now)
        z = self._keys.held('down', now) - self._keys.held('up', now)
        return x, z

    def act(self, observation: F32, now: float) -> NDArray[Any]:
        """Return the actions for a batch: `(N, A)` float32, or `(N,)` int64; always finite.

        :param observation: `(N, D)` float32.
        :param now: s, the clock of `press`.
        """
        seen = np.nan_to_num(observation.astype(np.float64))
        if self._lander:
            return self._fly_lander(seen, now)
        throttle = np.full(len(seen), 2 * self.throttle(now) - 1)
        if self.settings.assist:
            torque = self._hold_attitude(seen.T, *self.sideways(now))
        else:
            # A push towards +x is a turn about -Z, one towards +z about +X.
            x, z = self.sideways(now)
            share = self.settings.attitude_share
            torque = np.tile([[share * z], [-share * x]], len(seen))
        action = np.nan_to_num(np.stack((throttle, torque[0], torque[1]), axis=1))
        flown: F32 = np.clip(action, -1.0, 1.0).astype(np.float32)
        return flown

    def _hold_attitude(self, seen: F64, x: int, z: int) -> F64:
        """Return the torque `(2, N)` about X and Z, 1 for the maximum, not yet clipped.

        :param seen: `(15, N)` observations, transposed.
        """
        wanted = np.array([x * np.tan(self._lean), 1.0, z * np.tan(self._lean)])
        wanted /= np.sqrt((wanted**2).sum())
        s = self._spec.settings
        return attitude_torque(
            seen[6:9], seen[9:12:2] * s['spin_scale'], wanted,
            max(s['rcs_torque'] / s['inertia'], 1e-9), _ATTITUDE_RATE, 1.0, _BRAKE_SHARE)

    def _fly_lander(self, seen: F64, now: float) -> NDArray[Any]:
        """Return the lander's actions; its attitude law is that of Gymnasium's heuristic.

        :param seen: `(N, 8)` observations.
        """
        power, (x, _) = self._pulse(self.throttle(now)), self.sideways(now)
        if self.settings.assist:
            standing = seen[:, 6:8].any(axis=1)
            turn = 0.5 * (-x * self._lean - seen[:, 4]) - seen[:, 5]
            turn = np.where(standing, 0.0, turn)
        else:
            turn = np.full(len(seen), -float(x))
        flown: NDArray[Any]
        if self._spec.continuous:
            main = np.full(len(seen), max(2 * power - 1, _LEAST_COMMAND) if power else -1.0)
            flown = np.stack((main, np.clip(-20 * turn, -1.0, 1.0)), axis=1).astype(np.float32)
            return flown
        size = np.abs(turn)
        side = np.where(turn > 0, _LEFT, _RIGHT)
        needed, otherwise = (_TURN_NEEDED, _MAIN) if power else (_TURN_WANTED, _NOTHING)
        flown = np.where(size > needed, side, otherwise).astype(np.int64)
        return flown

    def _pulse(self, throttle: float) -> float:
        """Return the power, 0 to 1, at which the lander's main engine fires in this step.

        The engine has a minimum: with discrete actions it is on or off, with continuous ones it
        is off or fires at 50 % or more. A smaller throttle becomes a fraction of the steps.
        """
        power = max(throttle, 0.5) if self._spec.continuous else 1.0
        self._owed = self._owed + throttle if throttle else 0.0
        if self._owed < power - 1e-9:
            return 0.0
        self._owed -= power
        return power
