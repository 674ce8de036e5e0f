# SPDX-License-Identifier: Apache-2.0
"""Scripted pilot for an engine that cannot hover: lit once, it burns until touchdown.

With a minimum thrust above the weight, speed and height must reach zero together. The pilot
ignites early enough to brake with less than full thrust, follows a curve that never needs less
than the minimum, and plans the last steps one by one.
"""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

import numpy as np

from ppo_agent_node.pilots.expert.braking import BrakingProfile
from ppo_agent_node.pilots.expert.braking import last_steps
from ppo_agent_node.pilots.expert.descent import Descent
from ppo_agent_node.pilots.expert.descent import TimeToGo
from ppo_agent_node.pilots.expert.expert import ExpertSettings
from ppo_agent_node.pilots.expert.observed_state import ObservedState
from ppo_agent_node.pilots.expert.stateful import StatefulExpert
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import WorldSpec

FLOOR = 'throttle_floor_high'


@dataclass(frozen=True)
class HoverslamSettings(ExpertSettings):
    """Gains of the pilot of an engine that cannot hover."""

    braking_share: float = setting(
        0.8, '', 'planned deceleration, as a fraction of that of full throttle at half fuel',
        0.1, 1.0)
    lateral_stretch: float = setting(
        1.5, '', 'time allowed for the lateral motion, as a multiple of the shortest '
        'possible', 0.1, 10.0)
    tilt_cap: float = setting(38.0, 'deg', 'maximum commanded tilt', 0.0, 80.0)
    flare_speed: float = setting(0.02, 'm/s', 'touchdown speed', 1e-4, 2.0)
    last_speed: float = setting(
        2.0, 'm/s', 'speed above which the planned deceleration leaves a margin on both sides',
        0.01, 20.0)
    last_share: float = setting(
        0.5, '', "deceleration below that speed, from the engine's minimum (0) to its maximum (1)",
        0.0, 1.0)
    settled_time: float = setting(
        4.0, 's', 'remaining burn below which the pace of the descent stays fixed',
        0.0, 30.0)
    least_share: float = setting(
        0.05, '', "lower bound of the planned deceleration, from the engine's minimum (0) to its "
        'maximum (1)', 0.0, 1.0)


class HoverslamPilot(StatefulExpert):
    """Lands rockets whose engine has a minimum throttle and can be lit once. A `Pilot`.

    An observation does not tell whether the engine burns. A rocket is taken as lit if this pilot
    lit it, or if it has less energy than a fall from the lowest-energy spawn could leave.
    """

    name = 'hoverslam'
    settings_class = HoverslamSettings
    settings: HoverslamSettings
    profile: BrakingProfile

    def __init__(self, spec: WorldSpec, **gains: float) -> None:
        """Take the vehicle from the world's settings and the gains from the caller.

        :raises ValueError: as :class:`ExpertPilot` does.
        """
        self._floor = spec.settings.get(FLOOR, 0.0)  # other worlds are refused below
        super().__init__(spec, **gains)

    def _descent(self, net: float | F64) -> BrakingProfile:
        v, gain = self.vehicle, self.settings
        self._least = np.maximum(self._floor * self._full - v.gravity, 0.0)
        between = net - self._least
        return BrakingProfile(
            gain.braking_share * net, self._least + gain.last_share * between, gain.last_speed,
            gain.flare_speed, v.gravity, self._least + gain.least_share * between)

    def _look(self, observation: F32) -> ObservedState:
        state = super()._look(observation)
        self._memory.look(state)
        self._memory.lit |= self._has_braked(state)
        return state

    def _has_braked(self, state: ObservedState) -> Bools:
        """Return which rockets `(N,)` cannot have come here without thrust.

        A fall from rest in semi-implicit steps conserves v^2 / 2 + g v dt / 2 - g s exactly,
        except for drag, which over the fall s takes k g s^2 / m with the force k v^2.
        """
        v = self.vehicle
        fallen = v.spawn_height - v.touchdown_height - state.origin_height
        step = v.dt / v.substeps
        energy = (state.velocity**2).sum(axis=0) / 2 + v.gravity * (
            state.speed * step / 2 - fallen)
        drag = self._drag * v.gravity * fallen**2 / (v.dry_mass + v.fuel)
        braked: Bools = energy < -1.1 * drag - _TOLERANCE
        return braked

    def _mass(self, state: ObservedState) -> F64:
        """Return the mass `(N,)` kg: at spawn less burned fuel, or that of a standard flight."""
        v = self.vehicle
        left = np.maximum(v.fuel - self._memory.burnt, 0.0)
        return np.where(np.isnan(left), super()._mass(state), v.dry_mass + left)

    def _paced_profile(self, state: ObservedState) -> BrakingProfile:
        """Return the descent to follow; a lit rocket does not slow it down near the ground.

        If it already brakes gently, the curve continues unchanged: pace and distance to the axis
        depend on each other, and an oscillating curve would use the full range of thrust.
        """
        paced, on = super()._paced_profile(state), self.profile.through(state.height, state.speed)
        assert isinstance(paced, BrakingProfile)
        left = on.burn_time(on.speed(state.height))
        settled = self._memory.lit & (left < self.settings.settled_time)
        gentle = on.braking < _GENTLE * self.profile.braking
        braking = np.where(gentle, on.braking, np.maximum(on.braking, paced.braking))
        return replace(paced, braking=np.where(settled, braking, paced.braking))

    def _to_go(self, profile: Descent, state: ObservedState) -> TimeToGo:
        to_go = super()._to_go(profile, state)
        assert isinstance(profile, BrakingProfile)
        lit, burn = self._memory.lit, profile.burn_time(profile.speed(state.height))
        return TimeToGo(np.where(lit, 0.0, to_go.coast), np.where(lit, burn, to_go.burn))

    def _brake(self, profile: Descent, state: ObservedState, to_go: TimeToGo) -> F64:
        """Return the wanted deceleration `(N,)` m/s^2: on the curve, at the end step by step."""
        dt, touchdown_speed = self.vehicle.dt, self.settings.flare_speed
        # Half a step below the ground, so that the last step does not end just above it.
        below = state.height + touchdown_speed * dt / 2
        near = (state.height < profile.join_height) & (state.speed < 1.5 * profile.join_speed)
        return np.where(
            near, last_steps(below, state.speed, touchdown_speed, dt),
            super()._brake(profile, state, to_go))

    def _throttle(self, profile: Descent, state: ObservedState, wanted: F64) -> F64:
        """Return the throttle `(N,)`: zero while coasting, else the minimum or more.

        An engine that would stop the rocket above the ground is cut when a fall from there is
        harmless; otherwise it would only climb again.
        """
        coasting = ~self._memory.lit & (state.speed < profile.speed(state.height))
        height = np.maximum(state.height, 0.0)
        short = state.speed < _SHORT * np.sqrt(2 * self._least * height)
        harmless = state.speed**2 + 2 * self.vehicle.gravity * height < _HARMLESS**2
        off = coasting | (short & harmless)
        return np.where(off, 0.0, np.clip(wanted, self._floor, 1.0))


_TOLERANCE = 0.05
"""m^2/s^2, tolerance for rounding."""
_GENTLE = 0.7
"""Fraction of the planned deceleration."""
_SHORT, _HARMLESS = 0.7, 1.5
"""Fraction of the speed that minimum thrust would stop at the ground; m/s at touchdown."""
