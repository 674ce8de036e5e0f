# SPDX-License-Identifier: Apache-2.0
"""The scripted pilot of the rocket worlds: a hoverslam by the book, and the learner's teacher.

Four laws: a descent profile followed by feed-forward and feedback; a critically damped pull to
the pad's axis that ends with the descent; a pace that holds the descent back while the rocket has
too far to go sideways; a proportional-derivative law for the attitude on the cross product of the
up vector and the wanted one.
"""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.attitude import attitude_torque
from ppo_agent_node.pilots.descent import DescentProfile
from ppo_agent_node.pilots.descent import TimeToGo
from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.planar_vehicle import foot_height
from rocket_sim_node.worlds.vehicle import RocketSettings

F64 = NDArray[np.float64]

_SEEN = 15
"""numbers of an observation that are looked at, the first"""
_PACE_ITERATIONS = 4
_LEAST_SPIN_UP = 1e-9
"""rad/s^2 that the RCS is thought to give, one without torque too"""


@dataclass(frozen=True)
class ExpertSettings:
    """Gains of the scripted pilot."""

    braking_share: float = setting(
        0.935, '', 'planned deceleration, as a share of what full throttle gives at half fuel',
        0.1, 1.0)
    flare_rate: float = setting(12.5, '1/s', 'speed per height in the flare', 0.5, 100.0)
    flare_speed: float = setting(0.009, 'm/s', 'speed at touchdown the flare aims at', 1e-4, 2.0)
    speed_settling: float = setting(
        0.05, '', 'time in which errors in speed die out, as a share of the burn left', 0.0, 10.0)
    lateral_power: float = setting(
        4.6, '', 'the distance to the axis shrinks with this power of the time to go', 1.0, 20.0)
    lateral_time: float = setting(
        0.8, 's', 'time to go never thought shorter, sideways', 0.02, 10.0)
    lateral_reach: float = setting(
        3.3, 'm/s^2', 'lateral acceleration counted on when the pace is chosen', 0.1, 100.0)
    lateral_stretch: float = setting(
        1.5, '', 'time allowed sideways, as a multiple of the shortest possible', 0.1, 10.0)
    lateral_grace: float = setting(
        0.3, 's', 'time sideways that is not waited for, lest a small miss delay the touchdown',
        0.0, 10.0)
    tilt_reserve: float = setting(
        1.3, '', 'part of the first lateral pull that thrust is kept in reserve for', 0.0, 2.0)
    slowest: float = setting(0.24, '', 'smallest pace of the descent', 0.01, 1.0)
    tilt_cap: float = setting(31.0, 'deg', 'largest tilt asked for', 0.0, 80.0)
    attitude_rate: float = setting(24.0, 'rad/s', 'natural frequency of the attitude', 0.1, 50.0)
    attitude_damping: float = setting(0.78, '', 'damping ratio of the attitude', 0.1, 10.0)
    attitude_brake: float = setting(
        0.67, '', 'share of the RCS counted on to stop a turn', 0.05, 1.0)


class ExpertPilot:
    """Lands rockets from their observation alone; stateless, N rockets at a time. A `Pilot`.

    Fuel is not observed. The mass is taken to be that of a standard flight with as much burn time
    left: mass at spawn less the flow of full throttle over the time burnt so far, where a standard
    flight falls from rest at `spawn_height`. Feedback absorbs the difference.
    """

    name = 'expert'

    def __init__(self, spec: WorldSpec, **gains: float) -> None:
        """Take the vehicle from the world's settings and the gains from the caller.

        :param gains: fields of :class:`ExpertSettings`, the rest by default.
        :raises ValueError: for a world that is no rocket or has discrete actions, an unknown
            gain, one out of range, or a vehicle that cannot hover.
        """
        if not spec.continuous:
            raise ValueError(f'the expert steers continuously, but world {spec.name!r} does not')
        names = {field.name for field in fields(RocketSettings) if field.type != 'str'}
        known = {name: value for name, value in spec.settings.items() if name in names}
        if not {'max_thrust', 'rcs_torque', 'touchdown_height'} <= set(known):
            raise ValueError(f'the expert flies rockets, but world {spec.name!r} has none')
        self._feet = spec.settings
        self.settings = settings_module.build(ExpertSettings, gains)
        self.vehicle = settings_module.build(RocketSettings, known)
        v, gain = self.vehicle, self.settings
        self._full = v.max_thrust / (v.dry_mass + 0.5 * v.fuel)
        net = self._full - v.gravity
        if net <= 0 or not v.gravity:
            raise ValueError('the expert needs gravity and a thrust above the weight')
        self.profile = DescentProfile(
            gain.braking_share * net, gain.flare_rate, gain.flare_speed, v.gravity)
        self._flow = v.max_thrust / (v.specific_impulse * v.gravity)
        height = np.array([v.spawn_height - v.touchdown_height])
        self._standard_burn = float(self.profile.time_to_go(height, np.zeros(1)).burn[0])
        self._drag = 0.5 * v.air_density * v.drag_coefficient * v.drag_area

    def __call__(self, observation: F32) -> F32:
        """Return actions `(N, 3)`: throttle, RCS about X, RCS about Z, each in [-1, 1].

        :param observation: `(N, 15)`, see the world `rocket`; what comes after is not looked at.
        """
        v, gain = self.vehicle, self.settings
        seen = observation[:, :_SEEN].T.astype(np.float64)
        velocity = seen[3:6] * v.velocity_scale
        up = seen[6:9]
        spin = seen[9:12] * v.spin_scale
        offset = -seen[12:15] * v.position_scale
        height, lateral, drift = self._height(offset[1], up), offset[::2], velocity[::2]
        speed = -velocity[1]
        profile = self._paced_profile(height, speed, lateral, drift)
        to_go = profile.time_to_go(height, speed)
        mass = self._mass(self.profile.time_to_go(height, speed))
        lift = self._lift(profile, height, velocity, mass, to_go)
        pull = self._pull(lateral, drift, to_go)
        firing = np.where(to_go.coast > 0, v.gravity + profile.braking, lift)
        torque = attitude_torque(
            up, spin[::2], self._wanted_up(pull, firing),
            max(v.rcs_torque / v.inertia, _LEAST_SPIN_UP),
            gain.attitude_rate, gain.attitude_damping, gain.attitude_brake)
        throttle = lift * mass / (v.max_thrust * np.maximum(up[1], 0.1))
        action: F64 = np.stack((2 * throttle - 1, torque[0], torque[1]), axis=1)
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def _height(self, origin: F64, up: F64) -> F64:
        """Return how far there is to fall, `(N,)` m: in a world with feet, that of the lower one.

        :param origin: `(N,)` m, of the vehicle's origin above where it stands upright.
        """
        if 'stance' not in self._feet:
            return origin
        standing = self.vehicle.touchdown_height
        return foot_height(origin + standing, np.hypot(up[0], up[2]), up[1], self._feet)

    def _mass(self, to_go: TimeToGo) -> F64:
        """Return the estimated mass `(N,)` kg."""
        v = self.vehicle
        burnt = np.maximum(self._standard_burn - to_go.burn, 0.0)
        mass: F64 = np.maximum(v.dry_mass + v.fuel - self._flow * burnt, v.dry_mass)
        return mass

    def _paced_profile(
        self, height: F64, speed: F64, lateral: F64, drift: F64,
    ) -> DescentProfile:
        """Return the fastest descent whose burn lasts as long as the way to the axis.

        Pace and way depend on each other, as a slower descent begins to burn earlier, at another
        place; a few damped steps of fixed-point iteration settle that.
        """
        v, gain = self.vehicle, self.settings
        pace = np.ones_like(height)
        for _ in range(_PACE_ITERATIONS):
            to_go = self.profile.paced(pace).time_to_go(height, speed)
            begin = lateral + drift * to_go.coast
            needed = (
                gain.lateral_stretch * self._shortest(begin, drift) - gain.lateral_grace)
            in_time = pace * to_go.burn / np.maximum(needed, 1e-6)
            pull = gain.tilt_reserve * np.hypot(*self._pull(lateral, drift, to_go))
            left = np.sqrt(np.maximum(self._full**2 - pull**2, 0.0)) - v.gravity
            strong = np.sqrt(np.maximum(left / (self._full - v.gravity), 0.0))
            pace = np.clip(np.sqrt(pace * np.minimum(in_time, strong)), gain.slowest, 1.0)
        return self.profile.paced(pace)

    def _shortest(self, x: F64, drift: F64) -> F64:
        """Return the shortest time `(N,)` s from x and drift `(2, N)` to rest on the axis.

        For each axis under |x''| <= A it is s v / A + 2 sqrt(v^2 / (2 A^2) + s x / A), with s the
        sign of x + v |v| / (2 A): the time-optimal double integrator (Bryson and Ho, 'Applied
        optimal control', 1975, section 3.9). From rest it grows with the root of the distance, so
        fourth powers add as squares of distances do.
        """
        reach = self.settings.lateral_reach
        side = np.where(x + drift * np.abs(drift) / (2 * reach) < 0, -1.0, 1.0)
        inside = np.maximum((drift / reach)**2 / 2 + side * x / reach, 0.0)
        each = side * drift / reach + 2 * np.sqrt(inside)
        shortest: F64 = (each**4).sum(axis=0)**0.25
        return shortest

    def _lift(
        self, profile: DescentProfile, height: F64, velocity: F64, mass: F64, to_go: TimeToGo,
    ) -> F64:
        """Return the vertical acceleration `(N,)` m/s^2 wanted of the engine, 0 or more."""
        v, gain = self.vehicle, self.settings
        speed = -velocity[1]
        wanted = np.maximum(profile.next_speed(height, v.dt), 0.0)
        planned = profile.deceleration(wanted)
        excess = speed - wanted - planned * v.dt
        brake = planned + excess / np.maximum(gain.speed_settling * to_go.burn, v.dt)
        drag = self._drag * np.sqrt((velocity**2).sum(axis=0)) * speed / mass
        lift: F64 = np.clip(v.gravity + brake - drag, 0.0, v.max_thrust / mass)
        return lift

    def _pull(self, lateral: F64, drift: F64, to_go: TimeToGo) -> F64:
        """Return the acceleration `(2, N)` m/s^2 wanted along x and z.

        With t the burn left, x'' = -p^2 x / t^2 - (2 p - 1) x' / t has the double root x = t^p:
        critically damped in log t, and at rest on the axis at touchdown without tilt for p > 2.
        (p = 3.5 is, but for 12.25 in place of 12, the guidance of the Apollo lander: Klumpp,
        'Apollo lunar descent guidance', Automatica 10, 1974.) Far off, the speed towards the axis
        is limited to what `lateral_reach` can stop. Taken from the place where the burn begins,
        as nothing can be done before.
        """
        power = self.settings.lateral_power
        time = np.maximum(to_go.burn, self.settings.lateral_time)
        damping = (2 * power - 1) / time
        x = lateral + drift * to_go.coast
        stoppable = np.sqrt(2 * self.settings.lateral_reach / np.maximum(np.hypot(*x), 1e-12))
        approach = np.minimum(power**2 / time**2 / damping, stoppable)
        pull: F64 = -damping * (approach * x + drift)
        return pull

    def _wanted_up(self, pull: F64, lift: F64) -> F64:
        """Return the up vector `(3, N)` of a thrust with this lateral and vertical part."""
        gain = self.settings
        slope = pull / np.maximum(lift, 0.5 * self.vehicle.gravity)
        size = np.maximum(np.hypot(*slope), 1e-12)
        slope = slope * np.minimum(np.tan(np.deg2rad(gain.tilt_cap)) / size, 1.0)
        wanted = np.stack((slope[0], np.ones_like(lift), slope[1]))
        wanted /= np.sqrt((wanted**2).sum(axis=0))
        return wanted
