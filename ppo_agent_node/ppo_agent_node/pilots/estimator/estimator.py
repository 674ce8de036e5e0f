# SPDX-License-Identifier: Apache-2.0
"""Expert for off-nominal vehicles: identifies them in flight and predicts their state.

It applies the expert's laws to the state in which its command will take effect, a Smith predictor
(Smith, 'Closer control of loops with dead time', 1957), for the identified engine, RCS and side
acceleration, and inverts the engine's lag.
"""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

import numpy as np

from ppo_agent_node.pilots.estimator.identification import DELAYS
from ppo_agent_node.pilots.estimator.identification import Estimate
from ppo_agent_node.pilots.estimator.identification import Identification
from ppo_agent_node.pilots.estimator.kalman import VELOCITY
from ppo_agent_node.pilots.estimator.kalman import turn
from ppo_agent_node.pilots.estimator.state_filter import Expected
from ppo_agent_node.pilots.estimator.state_filter import StateFilter
from ppo_agent_node.pilots.expert.descent import Descent
from ppo_agent_node.pilots.expert.descent import DescentProfile
from ppo_agent_node.pilots.expert.descent import TimeToGo
from ppo_agent_node.pilots.expert.expert import ExpertSettings
from ppo_agent_node.pilots.expert.lateral import Pull
from ppo_agent_node.pilots.expert.lateral import drift_upright
from ppo_agent_node.pilots.expert.observed_state import ObservedState
from ppo_agent_node.pilots.expert.stateful import StatefulExpert
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import WorldSpec


@dataclass(frozen=True)
class EstimatorSettings(ExpertSettings):
    """Gains of the expert that identifies its vehicle."""

    lateral_time: float = setting(
        0.5, 's', 'lower bound of the lateral time to go', 0.02, 10.0)
    upright_time: float = setting(
        0.7, 's', 'remaining burn below which lateral control fades out, so that the rocket lands '
        'upright',
        1e-3, 10.0)
    attitude_rate: float = setting(
        16.0, 'rad/s', 'natural frequency of the attitude control', 0.1, 50.0)
    expected_strength: float = setting(
        0.94, '', "assumed factor of the engine's acceleration before ignition", 0.5, 1.5)
    strength_spread: float = setting(
        0.04, '', 'standard deviation of that factor over vehicles', 1e-4, 1.0)
    disturbance: float = setting(
        0.1, 'm/s^2', 'standard deviation of accelerations from the expected ones, with sensor '
        'noise',
        1e-3, 100.0)
    side_spread: float = setting(
        0.6, 'm/s^2', 'standard deviation of the side acceleration per axis', 1e-3, 100.0)
    side_wandering: float = setting(
        0.05, 'm/s^2', 'standard deviation of the change of the side acceleration in one second, '
        'with sensor noise', 1e-6, 100.0)
    side_memory: float = setting(
        5.0, 's', 'time constant with which measurements of the side acceleration are '
        'forgotten', 0.02, 1e4)
    side_upright_time: float = setting(
        0.3, 's', 'remaining burn below which the rocket no longer leans against the side '
        'acceleration',
        0.01, 10.0)
    lagging_flare: float = setting(
        2.0, '', 'upper bound of the flare rate, as a multiple of 1 / lag', 0.1, 1e3)
    noisy_flare_rate: float = setting(
        5.0, '1/s', 'upper bound of the flare rate, with sensor noise', 0.5, 1e3)
    noisy_lateral_time: float = setting(
        2.5, 's', 'lower bound of the lateral time to go, with sensor noise',
        0.02, 10.0)
    noise_margin: float = setting(
        2.0, '', 'increase of the touchdown speed, in standard deviations of height and '
        'speed', 0.0, 10.0)
    lag_inverted: float = setting(
        1.0, '', "fraction of the engine's lag that commands compensate", 0.0, 1.0)


class ExpertEstimator(StatefulExpert):
    """Lands rockets with unknown mass, thrust, RCS, lag, delay and side wind. A `Pilot`."""

    name = 'expert_estimator'
    settings_class = EstimatorSettings
    settings: EstimatorSettings

    def __init__(self, spec: WorldSpec, **gains: float) -> None:
        """Take the vehicle from the world's settings and the gains from the caller.

        :raises ValueError: as :class:`ExpertPilot` does.
        """
        super().__init__(spec, **gains)
        self._by_the_book = self._full
        self._prepare(0)

    def _prepare(self, count: int) -> None:
        """Forget all flights, and prepare for `count` rockets."""
        v, gain = self.vehicle, self.settings
        self._count = count
        self._identification = Identification(
            v, count, gain.side_memory, gain.expected_strength, gain.strength_spread)
        self._filter = StateFilter(count, v.dt, Expected(
            v.gravity, gain.expected_strength, gain.strength_spread, gain.side_spread,
            gain.side_wandering, gain.disturbance))
        self._found = self._identification.estimate()
        self._now = self._found.throttle
        self._full = self._by_the_book
        self.profile = self._descent(self._full - v.gravity)

    def __call__(self, observation: F32) -> F32:
        """Return actions `(N, 3)`, as :class:`ExpertPilot` does."""
        if len(observation) != self._count:
            self._prepare(len(observation))
        return super().__call__(observation)

    def _note(self, action: F32) -> None:
        """Record the action `(N, 3)` applied since the last call."""
        throttle = (action[:, 0].astype(np.float64) + 1) / 2
        self._identification.command(throttle, action[:, 1:].T.astype(np.float64))
        # Fuel flow follows the engine's actual throttle.
        self._memory.command(throttle + (self._now - throttle) * self._kept(self._found.lag))

    def _look(self, observation: F32) -> ObservedState:
        """Return the predicted observation at the time the command takes effect."""
        v, gain, state = self.vehicle, self.settings, super()._look(observation)
        fresh = self._memory.look(state)
        mass = self._book_mass(state)
        self._identification.forget(fresh)
        found = self._identification.learn(
            state, mass, ~fresh, VELOCITY * self._filter.noise)
        speed = np.sqrt((state.velocity**2).sum(axis=0))
        state = self._filter.update(
            state, fresh, found.throttle * v.max_thrust / mass, self._drag * speed / mass)
        noisy = self._filter.noise > 0
        self._found = found = replace(
            found, strength=np.where(noisy, self._filter.strength, found.strength),
            side=np.where(noisy, self._filter.side, found.side))
        self._full = np.maximum(self._by_the_book * found.strength, 1.01 * v.gravity)
        self._spin_up = found.turning * (v.rcs_torque / v.inertia)
        self.profile = self._flared(self._descent(self._full - v.gravity))
        self._lateral = replace(self._lateral, least_time=np.where(
            noisy, max(gain.lateral_time, gain.noisy_lateral_time), gain.lateral_time))
        return self._predict(state, mass, found)

    def _predict(self, state: ObservedState, mass: F64, found: Estimate) -> ObservedState:
        """Return the state after the pending commands, integrated step by step like the world."""
        v, commands = self.vehicle, self._identification.commands
        dt, rows = v.dt, np.arange(self._count)
        kept = self._kept(found.lag)
        height, lateral, velocity = state.height, state.lateral, state.velocity
        up, spin, self._now = state.up, state.spin, found.throttle
        full = v.max_thrust * found.strength / mass
        for step in range(min(int(found.delay.max(initial=0)), DELAYS - 1)):
            flying = step < found.delay
            asked = commands[np.maximum(found.delay - 1 - step, 0), :, rows].T
            throttle = asked[0] + (self._now - asked[0]) * kept
            now = ObservedState(height, state.origin_height, lateral, velocity, up, spin)
            push = self._acceleration(now, throttle * full, mass)
            torque = np.stack((asked[1], np.zeros_like(height), asked[2])) * self._spin_up
            faster = velocity + push * dt
            turned = spin + torque * dt
            self._now = np.where(flying, throttle, self._now)
            velocity, spin = np.where(flying, faster, velocity), np.where(flying, turned, spin)
            height = np.where(flying, height + velocity[1] * dt, height)
            lateral = np.where(flying, lateral + velocity[::2] * dt, lateral)
            up = np.where(flying, turn(up, spin, dt), up)
        return ObservedState(height, state.origin_height, lateral, velocity, up, spin)

    def _acceleration(self, state: ObservedState, push: F64, mass: F64) -> F64:
        """Return the acceleration `(3, N)` m/s^2 for an engine acceleration `push` `(N,)`."""
        drag = self._drag * np.sqrt((state.velocity**2).sum(axis=0)) / mass
        acceleration: F64 = state.up * push - drag * state.velocity
        acceleration[1] += self._found.fall - self.vehicle.gravity
        acceleration[::2] += self._found.side
        return acceleration

    def _kept(self, lag: F64) -> F64:
        """Return the part of its throttle `(N,)` that a lagging engine keeps over a step."""
        kept: F64 = np.exp(-self.vehicle.dt / np.maximum(lag, 1e-9))
        return kept

    def _book_mass(self, state: ObservedState) -> F64:
        """Return the nominal mass `(N,)` kg: the mass at spawn less the commanded fuel."""
        v = self.vehicle
        left = np.maximum(v.fuel - self._memory.burnt, 0.0)
        mass: F64 = np.where(np.isnan(left), super()._mass(state), v.dry_mass + left)
        return mass

    def _flared(self, profile: Descent) -> Descent:
        """Return a descent with a flare no sharper than lag and noise allow.

        Its touchdown speed leaves a margin for errors of height and speed.
        """
        assert isinstance(profile, DescentProfile)
        gain = self.settings
        height, speed = self._filter.deviation
        rate = np.minimum(
            profile.flare_rate, gain.lagging_flare / np.maximum(self._found.lag, 1e-3))
        rate = np.where(self._filter.noise > 0, np.minimum(rate, gain.noisy_flare_rate), rate)
        return replace(
            profile, flare_rate=rate,
            touchdown_speed=profile.touchdown_speed + gain.noise_margin * (rate * height + speed))

    def _pull(self, state: ObservedState, push: F64, to_go: TimeToGo) -> Pull:
        """Return the lateral thrust to apply, including compensation of the side acceleration."""
        way = drift_upright(self._found.side, to_go.burn, self.settings.side_upright_time)
        pull = self._lateral.pull(
            state.lateral - way.x, state.drift - way.drift, push + way.opposed, to_go)
        rate = np.where(to_go.coast > 0, pull.rate, pull.rate - way.opposed_rate)
        return Pull(pull.acceleration - way.opposed, rate)

    def _mass(self, state: ObservedState) -> F64:
        """Return the effective mass `(N,)` kg, by the observed effect of nominal thrust."""
        mass: F64 = self._book_mass(state) / self._found.strength
        return mass

    def _brake(self, profile: Descent, state: ObservedState, to_go: TimeToGo) -> F64:
        """Return the wanted deceleration `(N,)` m/s^2; a lagging engine is lit earlier."""
        lead = np.where(self._memory.lit, 0.0, self._found.lag)
        fall = self.vehicle.gravity * lead
        velocity = state.velocity.copy()
        velocity[1] -= fall
        later = state._replace(
            height=state.height - (state.speed + fall / 2) * lead, velocity=velocity)
        return super()._brake(profile, later, to_go)

    def _throttle(self, profile: Descent, state: ObservedState, wanted: F64) -> F64:
        """Return the throttle `(N,)` to command to a lagging engine for the wanted one."""
        kept = self._kept(self._found.lag * self.settings.lag_inverted)
        asked = (np.clip(wanted, 0.0, 1.0) - self._now * kept) / (1 - kept)
        throttle: F64 = np.clip(asked, 0.0, 1.0)
        return throttle
