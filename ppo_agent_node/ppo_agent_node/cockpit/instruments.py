# SPDX-License-Identifier: Apache-2.0
"""Instrument readings and braking model for hand flying.

Heights are above touchdown (m), speeds in m/s, angles in degrees; x is to the right, z nearer.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from dataclasses import replace

import numpy as np

from rocket_sim_node import worlds
from rocket_sim_node.settings import check
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.lunar import vehicle
from rocket_sim_node.worlds.lunar import view
from rocket_sim_node.worlds.planar.vehicle import foot_height
from rocket_sim_node.worlds.rocket.dynamics import OBSERVATION_NAMES

_NEWTON_STEPS = 6
_BISECTIONS = 30
_NEXT_TO_NOTHING = 1e-9
"""N or m/s^2: less thrust or gravity counts as none, so that squares of quotients are finite."""


def checked(spec: WorldSpec) -> WorldSpec:
    """Return a world reduced to the settings of its vehicle.

    :raises ValueError: for an unsupported world, and when a setting is missing or out of range or
        observations differ; names actual and expected value.
    """
    infos, lander = worlds.settings(spec.name), spec.name == 'lunar_lander'
    if lander:  # its maximum thrust follows from other settings
        infos += tuple(info for info in worlds.settings('rocket') if info.name == 'max_thrust')
    names = view.OBSERVATION_NAMES if lander else OBSERVATION_NAMES
    if spec.observation_names != names:
        raise ValueError(
            f'world: observation_names: got {spec.observation_names}, expected {names}')
    said = {**spec.settings, **worlds.settings_from(spec.name, spec.settings)}
    try:
        for info in infos:
            check(info, said.get(info.name))
    except (TypeError, ValueError) as error:
        raise ValueError(f'world: settings: {error}') from error
    return replace(spec, settings={info.name: float(spec.settings[info.name]) for info in infos})


@dataclass(frozen=True)
class Readings:
    """Instrument readings of one vehicle."""

    height: float
    """m."""
    climb: float
    """m/s, upwards."""
    drift: tuple[float, float]
    """m/s along x and z."""
    offset: tuple[float, float]
    """m along x and z, from the pad's centre."""
    lean: tuple[float, float]
    """deg, towards x and towards z."""
    tilt: float
    """deg."""


def read(spec: WorldSpec, observation: F32) -> Readings:
    """Return the readings of one vehicle.

    :param observation: `(D,)`, of a world of rockets or of the lander.
    """
    o = observation.astype(np.float64).tolist()
    if spec.name == 'lunar_lander':
        wide, high = vehicle.HALF_WIDTH, vehicle.HALF_HEIGHT
        drift, climb = (float(speed[0]) for speed in view.seen_velocity(observation[None]))
        lean = -math.degrees(math.remainder(o[4], math.tau))
        return Readings(
            o[1] * high, climb, (drift, 0.0), (o[0] * wide, 0.0),
            (lean, 0.0), abs(lean))
    s = spec.settings
    height = -o[13] * s['position_scale']
    sideways = math.hypot(o[6], o[8])
    if 'stance' in s:
        height = float(foot_height(
            height + s['touchdown_height'], np.array(sideways), np.array(o[7]), s))
    speed, place = s['velocity_scale'], s['position_scale']
    return Readings(
        height, o[4] * speed, (o[3] * speed, o[5] * speed), (o[0] * place, o[2] * place),
        (math.degrees(math.atan2(o[6], o[7])), math.degrees(math.atan2(o[8], o[7]))),
        math.degrees(math.atan2(sideways, o[7])))


@dataclass(frozen=True)
class Brake:
    """Braking at full throttle, straight up, until the fall is stopped; without drag.

    With the flow q and the exhaust speed c a burn of t reduces the speed by
    c ln(m / (m - q t)) - g t, over v t + g t^2 / 2 - c (t - (m - q t) / q ln(m / (m - q t))) of
    height.
    """

    thrust: float
    """N."""
    flow: float
    """kg/s."""
    dry_mass: float
    """kg."""
    gravity: float
    """m/s^2."""

    @classmethod
    def of(cls, spec: WorldSpec) -> Brake:
        """Return the braking model of a world's vehicle.

        :raises ValueError: as `checked` does.
        """
        s = checked(spec).settings
        thrust, gravity = (
            s[name] if s[name] > _NEXT_TO_NOTHING else 0.0 for name in ('max_thrust', 'gravity'))
        if spec.name == 'lunar_lander':
            return cls(thrust, 0.0, vehicle.TOTAL_MASS, gravity)
        exhaust = s['specific_impulse'] * gravity
        return cls(thrust, thrust / exhaust if exhaust else 0.0, s['dry_mass'], gravity)

    def time(self, speed: float, mass: float) -> float:
        """Return the time to stop, s; infinite when thrust or fuel do not suffice.

        :param speed: m/s, downwards.
        :param mass: kg, at ignition.
        """
        if speed <= 0:
            return 0.0
        net = self.thrust / mass - self.gravity
        if net <= 0:
            return math.inf
        time = speed / net
        # The deceleration grows, so Newton's method approaches the root from above.
        for _ in range(_NEWTON_STEPS if self.flow else 0):
            time = min(time, 0.999 * mass / self.flow)
            excess = self._taken(time, mass) - speed
            time -= excess / (self.thrust / (mass - self.flow * time) - self.gravity)
        enough = self.flow * time <= mass - self.dry_mass + 1e-9
        return time if enough else math.inf

    def height(self, speed: float, mass: float) -> float:
        """Return the height needed to stop, m; infinite when it is impossible."""
        time = self.time(speed, mass)
        return self._fallen(speed, time, mass) if math.isfinite(time) else math.inf

    def touchdown_speed(self, height: float, speed: float, mass: float) -> float:
        """Return the speed at the ground when burning from now on, m/s.

        If the fuel does not suffice to stop, it is burned completely; the rest is free fall.
        """
        time = self.time(speed, mass)
        stops = math.isfinite(time)
        if not stops:
            if not self.flow:
                return math.sqrt(max(
                    speed**2 + 2 * (self.gravity - self.thrust / mass) * height, 0.0))
            time = max(mass - self.dry_mass, 0.0) / self.flow
        fallen = self._fallen(speed, time, mass)
        if fallen <= height:
            left = max(speed - self._taken(time, mass), 0.0)
            return 0.0 if stops else math.sqrt(left**2 + 2 * self.gravity * (height - fallen))
        low, high = 0.0, time
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._fallen(speed, middle, mass) < height:
                low = middle
            else:
                high = middle
        return max(speed - self._taken(high, mass), 0.0)

    def wait(self, height: float, speed: float, mass: float) -> float:
        """Return how long free fall may last before full throttle just stops it, s; or 0."""
        g = self.gravity

        def margin(time: float) -> float:
            later = speed + g * time
            return height - speed * time - g * time**2 / 2 - self.height(later, mass)

        if margin(0.0) <= 0 or not g:
            return 0.0
        low, high = 0.0, (speed + math.sqrt(speed**2 + 2 * g * height)) / g
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if margin(middle) > 0:
                low = middle
            else:
                high = middle
        return low

    def _taken(self, time: float, mass: float) -> float:
        """Return the speed reduction of a burn, m/s."""
        if not self.flow:
            return (self.thrust / mass - self.gravity) * time
        gained = self.thrust / self.flow * math.log(mass / (mass - self.flow * time))
        return gained - self.gravity * time

    def _fallen(self, speed: float, time: float, mass: float) -> float:
        """Return the distance fallen during a burn, m."""
        fall = speed * time + self.gravity * time**2 / 2
        if not self.flow:
            return fall - self.thrust / mass * time**2 / 2
        left = mass - self.flow * time
        return fall - self.thrust / self.flow * (
            time - left / self.flow * math.log(mass / left))
