# SPDX-License-Identifier: Apache-2.0
"""Scripted pilot of the rocket worlds: a hoverslam, and the learner's teacher.

Four laws: a descent profile followed by feed-forward and feedback; a critically damped lateral
acceleration to the pad's axis that ends with the descent; a pace that slows the descent while the
rocket is too far from the axis; a proportional-derivative attitude law on the cross product of the
up vector and the wanted one, with the rotation of the wanted one fed forward.
"""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.expert.attitude import attitude_torque
from ppo_agent_node.pilots.expert.descent import Descent
from ppo_agent_node.pilots.expert.descent import DescentProfile
from ppo_agent_node.pilots.expert.descent import TimeToGo
from ppo_agent_node.pilots.expert.lateral import LateralLaw
from ppo_agent_node.pilots.expert.lateral import Pull
from ppo_agent_node.pilots.expert.observed_state import ObservedState
from ppo_agent_node.pilots.expert.observed_state import look
from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

F64 = NDArray[np.float64]

_PACE_ITERATIONS = 4
_LEAST_SPIN_UP = 1e-9
"""rad/s^2, minimum assumed for the RCS, even if it has no torque."""


@dataclass(frozen=True)
class ExpertSettings:
    """Gains of the scripted pilot."""

    braking_share: float = setting(
        0.93, '', 'planned deceleration, as a fraction of that of full throttle at half fuel',
        0.1, 1.0)
    flare_rate: float = setting(42.0, '1/s', 'ratio of speed to height in the flare', 0.5, 1000.0)
    flare_speed: float = setting(
        0.0084, 'm/s', 'touchdown speed that the flare aims at', 1e-4, 2.0)
    speed_settling: float = setting(
        0.053, '', 'time constant of speed errors, as a fraction of the remaining burn', 0.0, 10.0)
    least_settling: float = setting(
        0.0, 's', 'lower bound of that time constant, which is at least one step', 0.0, 10.0)
    lateral_power: float = setting(
        5.2, '', 'power of the time to go with which the distance to the axis shrinks', 1.0, 20.0)
    lateral_time: float = setting(
        0.43, 's', 'lower bound of the lateral time to go', 0.02, 10.0)
    upright_time: float = setting(
        0.41, 's', 'remaining burn below which lateral control fades out, so that the rocket '
        'lands upright',
        1e-3, 10.0)
    lateral_reach: float = setting(
        4.2, 'm/s^2', 'lateral acceleration assumed when the pace is chosen', 0.1, 100.0)
    lateral_stretch: float = setting(
        1.8, '', 'time allowed for the lateral motion, as a multiple of the shortest '
        'possible', 0.1, 10.0)
    lateral_grace: float = setting(
        0.22, 's', 'lateral time that does not delay the descent, so that a small miss does not '
        'delay the touchdown',
        0.0, 10.0)
    tilt_reserve: float = setting(
        1.4, '', 'fraction of the initial lateral acceleration for which thrust is kept in '
        'reserve', 0.0, 2.0)
    slowest: float = setting(0.24, '', 'lower bound of the pace of the descent', 0.01, 1.0)
    tilt_cap: float = setting(31.0, 'deg', 'maximum commanded tilt', 0.0, 80.0)
    attitude_rate: float = setting(
        27.0, 'rad/s', 'natural frequency of the attitude control', 0.1, 50.0)
    attitude_damping: float = setting(0.96, '', 'damping ratio of the attitude control', 0.1, 10.0)
    attitude_brake: float = setting(
        0.57, '', 'fraction of the RCS torque assumed available to stop a rotation', 0.05, 1.0)


class ExpertPilot:
    """Lands rockets from their observation alone; stateless, N rockets at a time. A `Pilot`.

    Fuel is not observed. The mass is assumed to be that of a standard flight with the same burn
    time left: mass at spawn less the flow of full throttle over the time burned so far, where a
    standard flight falls from rest at `spawn_height`. Feedback absorbs the difference.
    """

    name = 'expert'
    settings_class = ExpertSettings

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
        self._world = spec.settings
        self.settings = settings_module.build(self.settings_class, gains)
        self.vehicle = settings_module.build(RocketSettings, known)
        v, gain = self.vehicle, self.settings
        self._spin_up: float | F64 = v.rcs_torque / v.inertia
        self._full: float | F64 = v.max_thrust / (v.dry_mass + 0.5 * v.fuel)
        if not 0 < v.gravity < self._full:
            raise ValueError('the expert needs gravity and a thrust above the weight')
        self.profile: Descent = self._descent(self._full - v.gravity)
        self._lateral = LateralLaw(
            gain.lateral_power, gain.lateral_time, gain.lateral_reach, gain.upright_time)
        self._flow = v.max_thrust / (v.specific_impulse * v.gravity)
        height = np.array([v.spawn_height - v.touchdown_height])
        self._standard_burn = float(self.profile.time_to_go(height, np.zeros(1)).burn[0])
        self._drag = 0.5 * v.air_density * v.drag_coefficient * v.drag_area

    def __call__(self, observation: F32) -> F32:
        """Return actions `(N, 3)`: throttle, RCS about X, RCS about Z, each in [-1, 1].

        :param observation: `(N, 15)`, see world `rocket`; further columns are ignored.
        """
        v, gain = self.vehicle, self.settings
        state = self._look(observation)
        profile = self._paced_profile(state)
        to_go = self._to_go(profile, state)
        mass = self._mass(state)
        lift = self._lift(profile, state, mass, to_go)
        # The lift while braking, also in the flare, which is too short to lean into.
        firing = np.maximum(v.gravity + profile.braking, np.where(to_go.coast > 0, 0.0, lift))
        pull = self._pull(state, firing * state.up[::2] / state.upright, to_go)
        wanted, turning = self._wanted_up(pull, firing)
        torque = attitude_torque(
            state.up, state.spin[::2], wanted, np.maximum(self._spin_up, _LEAST_SPIN_UP),
            gain.attitude_rate, gain.attitude_damping, gain.attitude_brake, turning)
        throttle = self._throttle(profile, state, lift * mass / (v.max_thrust * state.upright))
        action: F64 = np.stack((2 * throttle - 1, torque[0], torque[1]), axis=1)
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def _look(self, observation: F32) -> ObservedState:
        """Return the observed state."""
        return look(observation, self._world)

    def _descent(self, net: float | F64) -> Descent:
        """Return the descent profile, with `net` m/s^2 the deceleration at full throttle."""
        gain = self.settings
        return DescentProfile(
            gain.braking_share * net, gain.flare_rate, gain.flare_speed, self.vehicle.gravity)

    def _throttle(self, profile: Descent, state: ObservedState, throttle: F64) -> F64:
        """Return the throttle `(N,)` to command for this wanted throttle."""
        return throttle

    def _to_go(self, profile: Descent, state: ObservedState) -> TimeToGo:
        """Return the time until touchdown."""
        return profile.time_to_go(state.height, state.speed)

    def _mass(self, state: ObservedState) -> F64:
        """Return the estimated mass `(N,)` kg."""
        v = self.vehicle
        to_go = self.profile.time_to_go(state.height, state.speed)
        burnt = np.maximum(self._standard_burn - to_go.burn, 0.0)
        mass: F64 = np.maximum(v.dry_mass + v.fuel - self._flow * burnt, v.dry_mass)
        return mass

    def _paced_profile(self, state: ObservedState) -> Descent:
        """Return the fastest descent whose burn is long enough to reach the axis.

        Pace and distance depend on each other, as a slower descent ignites earlier, at another
        position; a few damped steps of fixed-point iteration solve for both.
        """
        v, gain = self.vehicle, self.settings
        lateral, drift = state.lateral, state.drift
        pace = np.ones_like(state.height)
        for _ in range(_PACE_ITERATIONS):
            to_go = self._to_go(self.profile.paced(pace), state)
            begin = lateral + drift * to_go.coast
            needed = (
                gain.lateral_stretch * self._lateral.shortest(begin, drift) - gain.lateral_grace)
            in_time = pace * to_go.burn / np.maximum(needed, 1e-6)
            pull = gain.tilt_reserve * np.hypot(*self._lateral.first_pull(lateral, drift, to_go))
            left = np.sqrt(np.maximum(self._full**2 - pull**2, 0.0)) - v.gravity
            strong = np.sqrt(np.maximum(left / (self._full - v.gravity), 0.0))
            pace = np.clip(np.sqrt(pace * np.minimum(in_time, strong)), gain.slowest, 1.0)
        return self.profile.paced(pace)

    def _lift(
        self, profile: Descent, state: ObservedState, mass: F64, to_go: TimeToGo,
    ) -> F64:
        """Return the wanted vertical acceleration `(N,)` m/s^2 of the engine, 0 or more."""
        v = self.vehicle
        brake = self._brake(profile, state, to_go)
        drag = self._drag * np.sqrt((state.velocity**2).sum(axis=0)) * state.speed / mass
        lift: F64 = np.clip(v.gravity + brake - drag, 0.0, v.max_thrust / mass)
        return lift

    def _brake(self, profile: Descent, state: ObservedState, to_go: TimeToGo) -> F64:
        """Return the wanted deceleration `(N,)` m/s^2."""
        dt, gain = self.vehicle.dt, self.settings
        wanted = np.maximum(profile.next_speed(state.height, dt), 0.0)
        planned = profile.deceleration(wanted)
        excess = state.speed - wanted - planned * dt
        settling = np.maximum(gain.speed_settling * to_go.burn, max(gain.least_settling, dt))
        return planned + excess / settling

    def _pull(self, state: ObservedState, push: F64, to_go: TimeToGo) -> Pull:
        """Return the lateral thrust to apply, given the present one, `push` `(2, N)` m/s^2."""
        return self._lateral.pull(state.lateral, state.drift, push, to_go)

    def _wanted_up(self, pull: Pull, lift: F64) -> tuple[F64, F64]:
        """Return the up vector `(3, N)` of a thrust with this lateral and vertical part.

        Also return its rotation, `(2, N)` rad/s about X and Z; 0 where the tilt is limited.
        """
        slope = pull.acceleration / lift
        size = np.maximum(np.hypot(*slope), 1e-12)
        within = np.minimum(np.tan(np.deg2rad(self.settings.tilt_cap)) / size, 1.0)
        wanted = np.stack((slope[0] * within, np.ones_like(lift), slope[1] * within))
        wanted /= np.sqrt((wanted**2).sum(axis=0))
        rate = np.where(within < 1, 0.0, pull.rate / lift * wanted[1]**2)
        return wanted, np.stack((rate[1], -rate[0]))
