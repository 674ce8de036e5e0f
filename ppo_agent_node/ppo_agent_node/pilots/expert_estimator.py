# SPDX-License-Identifier: Apache-2.0
"""The expert of vehicles that are not by the book: it identifies them in flight, and predicts.

It flies the expert's laws on the state in which its command will arrive, a Smith predictor
(Smith, 'Closer control of loops with dead time', 1957), for the engine, RCS and side acceleration
that it has identified, and inverts the engine's lag.
"""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

import numpy as np

from ppo_agent_node.pilots.descent import Descent
from ppo_agent_node.pilots.descent import DescentProfile
from ppo_agent_node.pilots.descent import TimeToGo
from ppo_agent_node.pilots.expert import ExpertPilot
from ppo_agent_node.pilots.expert import ExpertSettings
from ppo_agent_node.pilots.identification import DELAYS
from ppo_agent_node.pilots.identification import Estimate
from ppo_agent_node.pilots.identification import Identification
from ppo_agent_node.pilots.lateral import Pull
from ppo_agent_node.pilots.lateral import drift_upright
from ppo_agent_node.pilots.memory import FlightMemory
from ppo_agent_node.pilots.sight import Sight
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import WorldSpec


@dataclass(frozen=True)
class EstimatorSettings(ExpertSettings):
    """Gains of the expert that identifies its vehicle."""

    expected_strength: float = setting(
        0.94, '', 'factor of the acceleration of the engine before it has been lit', 0.5, 1.5)
    nominal_weight: float = setting(
        0.1, '', 'steps of full thrust that the nominal engine counts for', 1e-6, 1e6)
    side_memory: float = setting(
        5.0, 's', 'in which measurements of the side acceleration are forgotten', 0.02, 1e4)
    side_upright_time: float = setting(
        0.3, 's', 'burn left from which on it is no longer leant against the side acceleration',
        0.01, 10.0)
    lagging_flare: float = setting(
        2.0, '', 'flare rate at most, as a multiple of 1 / lag', 0.1, 1e3)
    lag_inverted: float = setting(
        1.0, '', 'share of the lag of the engine that commands make up for', 0.0, 1.0)


class ExpertEstimator(ExpertPilot):
    """Lands rockets whose mass, thrust, RCS, lag, delay and side wind are not told. A `Pilot`.

    Remembers a flight for as long as its row goes on; see :class:`FlightMemory`.
    """

    name = 'expert_estimator'
    settings_class = EstimatorSettings
    settings: EstimatorSettings

    def __init__(self, spec: WorldSpec, **gains: float) -> None:
        """Take the vehicle from the world's settings and the gains from the caller.

        :raises ValueError: as :class:`ExpertPilot` does.
        """
        self._found: Estimate | None = None
        super().__init__(spec, **gains)
        self._memory = FlightMemory(self.vehicle)
        self._count = -1
        self._book_full = self._full

    def __call__(self, observation: F32) -> F32:
        """Return actions `(N, 3)`, as :class:`ExpertPilot` does."""
        if len(observation) != self._count:
            self._count = len(observation)
            self._identification = Identification(
                self.vehicle, self._count, self.settings.nominal_weight,
                self.settings.side_memory, self.settings.expected_strength)
        action = super().__call__(observation)
        throttle = (action[:, 0].astype(np.float64) + 1) / 2
        self._identification.command(throttle, action[:, 1:].T.astype(np.float64))
        # Fuel flows as the engine follows.
        self._memory.command(throttle + (self._now - throttle) * self._kept(self._found.lag))
        return action

    def _look(self, observation: F32) -> Sight:
        """Return what will be seen when the command arrives."""
        v, sight = self.vehicle, super()._look(observation)
        fresh = self._memory.look(sight)
        self._identification.forget(fresh)
        mass = self._book_mass(sight)
        self._identification.learn(sight, mass, ~fresh)
        found = self._found = self._identification.estimate()
        self._full = np.maximum(self._book_full * found.strength, 1.01 * v.gravity)
        self._spin_up = found.turning * (v.rcs_torque / v.inertia)
        self.profile = self._descent(self._full - v.gravity)
        return self._predict(sight, mass, found)

    def _predict(self, sight: Sight, mass: F64, found: Estimate) -> Sight:
        """Return the state after the commands that are under way, step by step as the world."""
        v, commands = self.vehicle, self._identification.commands
        dt, rows = v.dt, np.arange(self._count)
        kept = self._kept(found.lag)
        height, lateral, velocity = sight.height, sight.lateral, sight.velocity
        up, spin, self._now = sight.up, sight.spin, found.throttle
        full = v.max_thrust * found.strength / mass
        for step in range(min(int(found.delay.max(initial=0)), DELAYS - 1)):
            flying = step < found.delay
            asked = commands[np.maximum(found.delay - 1 - step, 0), :, rows].T
            throttle = asked[0] + (self._now - asked[0]) * kept
            drag = self._drag * np.sqrt((velocity**2).sum(axis=0)) / mass
            push = up * (throttle * full) - drag * velocity
            push[1] -= v.gravity
            push[::2] += found.side
            torque = np.stack((asked[1], np.zeros_like(height), asked[2])) * self._spin_up
            faster = velocity + push * dt
            turned = spin + torque * dt
            self._now = np.where(flying, throttle, self._now)
            velocity, spin = np.where(flying, faster, velocity), np.where(flying, turned, spin)
            height = np.where(flying, height + velocity[1] * dt, height)
            lateral = np.where(flying, lateral + velocity[::2] * dt, lateral)
            leant = up + np.cross(spin, up, axis=0) * dt
            up = np.where(flying, leant / np.sqrt((leant**2).sum(axis=0)), up)
        return Sight(height, sight.origin_height, lateral, velocity, up, spin)

    def _kept(self, lag: F64) -> F64:
        """Return which part of its throttle `(N,)` an engine keeps over a step."""
        kept: F64 = np.exp(-self.vehicle.dt / np.maximum(lag, 1e-9))
        return kept

    def _book_mass(self, sight: Sight) -> F64:
        """Return the mass `(N,)` kg by the book: that at spawn less the fuel commanded."""
        v = self.vehicle
        left = np.maximum(v.fuel - self._memory.burnt, 0.0)
        return np.where(np.isnan(left), super()._mass(sight), v.dry_mass + left)

    def _descent(self, net: float | F64) -> Descent:
        """Return the descent to follow, with no sharper a flare than the engine's lag allows."""
        profile, found = super()._descent(net), self._found
        assert isinstance(profile, DescentProfile)
        if found is None:
            return profile
        rate = self.settings.lagging_flare / np.maximum(found.lag, 1e-3)
        return replace(profile, flare_rate=np.minimum(profile.flare_rate, rate))

    def _pull(self, sight: Sight, push: F64, to_go: TimeToGo) -> Pull:
        """Return what thrust shall do sideways, held against the side acceleration."""
        assert self._found is not None
        way = drift_upright(self._found.side, to_go.burn, self.settings.side_upright_time)
        pull = self._lateral.pull(
            sight.lateral - way.x, sight.drift - way.drift, push + way.opposed, to_go)
        rate = np.where(to_go.coast > 0, pull.rate, pull.rate - way.opposed_rate)
        return Pull(pull.acceleration - way.opposed, rate)

    def _mass(self, sight: Sight) -> F64:
        """Return the mass `(N,)` kg that the thrust by the book moves as it was seen to."""
        return self._book_mass(sight) / self._found.strength

    def _brake(self, profile: Descent, sight: Sight, to_go: TimeToGo) -> F64:
        """Return the deceleration `(N,)` m/s^2 wanted; an engine that lags is lit earlier."""
        lead = np.where(self._memory.lit, 0.0, self._found.lag)
        fall = self.vehicle.gravity * lead
        velocity = sight.velocity.copy()
        velocity[1] -= fall
        later = sight._replace(
            height=sight.height - (sight.speed + fall / 2) * lead, velocity=velocity)
        return super()._brake(profile, later, to_go)

    def _throttle(self, profile: Descent, sight: Sight, wanted: F64) -> F64:
        """Return the throttle `(N,)` to command so that the engine gives what is wanted."""
        kept = self._kept(self._found.lag * self.settings.lag_inverted)
        asked = (np.clip(wanted, 0.0, 1.0) - self._now * kept) / (1 - kept)
        throttle: F64 = np.clip(asked, 0.0, 1.0)
        return throttle
