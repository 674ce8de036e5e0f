# SPDX-License-Identifier: Apache-2.0
"""Minimum fuel and minimum time of soft landings in the rocket worlds, for a given start.

For each number of steps a cone program determines whether a soft landing exists and its fuel (see
`landing_program`). Minimum time is the smallest number with a landing. With more steps fuel first
falls and then rises, as hovering costs fuel; minimum fuel is at the turning point.

Attitude dynamics are ignored: the thrust may point anywhere within the tilt limit, at once, in
flight and at touchdown. A real vehicle has to turn first, so both are lower bounds for it, and the
return has an upper bound: that of a touchdown at no speed, tilt and distance after the minimum
time.

Two details of the bounds. A thrust that is held over blocks of steps costs slightly more than one
that changes in each step. And touchdown is at 1 cm/s: a faster landing needs less fuel, by some
10 kg for each m/s.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ppo_agent_node.evaluation.optimum.landing_program import LandingProgram
from ppo_agent_node.evaluation.optimum.landing_program import Plan
from ppo_agent_node.evaluation.optimum.point_mass import F64
from ppo_agent_node.evaluation.optimum.point_mass import PointMass
from rocket_sim_node.worlds.rocket import conditions

BLOCKS = 60
_LANDS = 1e-5
"""m, tolerance of the miss."""
_SETTLED, _EXACT = 1e-3, 1e-7
"""m and m/s, tolerances of the corrections: during the search for the steps, and at its end."""
_REPEATS = 6
_GROWTH = 1.1
"""Factor by which the number of steps is increased while there is no plan."""
_FASTER = 1.15
"""Maximum factor between the highest speeds of a flight and of a straight drop."""


@dataclass(frozen=True)
class Landing:
    """A soft landing of a point mass, in the world's steps."""

    steps: int
    fuel: float
    """kg."""
    time: F64
    """`(S + 1,)` s, from 0."""
    position: F64
    """`(S + 1, 3)` m, y up, of the vehicle's origin."""
    velocity: F64
    """`(S + 1, 3)` m/s."""
    thrust: F64
    """`(S, 3)` N, each held for a step."""


@dataclass(frozen=True)
class Optimum:
    """The best landings from one start."""

    least_fuel: Landing
    least_time: Landing
    """Of equally short landings, the one with the least fuel."""


class LandingOptimiser:
    """Solves starts of one vehicle, one at a time, as it reuses the solver's memory."""

    def __init__(self, settings: Mapping[str, float], blocks: int = BLOCKS) -> None:
        """Store the vehicle's constants.

        :param settings: of a rocket world, by name, as in `WorldSpec.settings`.
        :param blocks: number of nearly equal parts of a flight in which the thrust is constant.
        :raises ValueError: for a vehicle without weight, thrust or fuel, or one whose conditions
            are not nominal: a minimum throttle would make the problem non-convex.
        :raises KeyError: when a constant is missing.
        """
        for name in ('gravity', 'max_thrust', 'fuel'):
            if not settings[name] > 0:
                raise ValueError(f'{name}: got {settings[name]}, expected more than 0')
        if conditions.name_of(settings) != 'nominal':
            raise ValueError(
                f'conditions: got {conditions.name_of(settings)}, expected nominal')
        self._vehicle = PointMass.of(settings)
        self._program = LandingProgram(self._vehicle, blocks, settings['tilt_limit'])
        self._ground = np.array([0.0, settings['touchdown_height'], 0.0])
        self._most_steps = int(np.floor(settings['time_limit'] / self._vehicle.dt + 1e-9))

    def solve(self, position: F64, velocity: F64) -> Optimum | None:
        """Return the best landings, None if no landing is possible.

        :param position: `(3,)` m, y up, of the vehicle's origin at the start.
        :param velocity: `(3,)` m/s.
        :raises ValueError: for a start that is not finite or not above touchdown height.
        """
        position, velocity = (np.asarray(part, np.float64) for part in (position, velocity))
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise ValueError(f'start: got {position} m, {velocity} m/s, expected finite numbers')
        if position[1] <= self._ground[1]:
            raise ValueError(
                f'start: got a height of {position[1]} m, expected more than {self._ground[1]} m, '
                'where it touches down')
        search = _Search(
            self._program, position - self._ground, velocity, self._most_steps)
        least_steps = search.least_steps()
        if least_steps is None:
            return None
        best_steps = search.least_fuel(least_steps)
        quick, cheap = search.exact(least_steps), search.exact(best_steps)
        if quick is None or cheap is None:
            return None
        return Optimum(
            least_fuel=self._fly(position, velocity, cheap, best_steps),
            least_time=self._fly(position, velocity, quick, least_steps))

    def _fly(self, position: F64, velocity: F64, plan: Plan, steps: int) -> Landing:
        """Return the motion of the world's point mass under the plan's thrust."""
        thrust = np.repeat(self._program.thrust(plan), self._program.lengths(steps), axis=0)
        state = position[None], velocity[None], np.array([self._vehicle.mass])
        states = [state]
        for force in thrust:
            state = self._vehicle.step(*state, force[None])
            states.append(state)
        return Landing(
            steps=steps, fuel=float(self._vehicle.mass - state[2][0]),
            time=self._vehicle.dt * np.arange(steps + 1.0),
            position=np.concatenate([one[0] for one in states]),
            velocity=np.concatenate([one[1] for one in states]), thrust=thrust)


class _Search:
    """Search for the best numbers of steps from one start.

    Successive convexification: each solution provides the nonlinear corrections of the next
    program (Szmuk, Acikmese and Berning, 'Successive convexification for fuel-optimal powered
    landing with aerodynamic drag and non-convex constraints', AIAA 2016-0378), whose number of
    steps may differ slightly.
    """

    def __init__(
        self, program: LandingProgram, position: F64, velocity: F64, most_steps: int,
    ) -> None:
        """Store the start.

        :param position: `(3,)` m from the target point on the pad.
        :param velocity: `(3,)` m/s.
        :param most_steps: maximum steps of a flight.
        """
        self._program, self._position, self._velocity = program, position, velocity
        self._most = most_steps
        self._plans: dict[int, Plan | None] = {}
        self._exact: dict[int, Plan | None] = {}
        self._last: Plan | None = None

    def least_steps(self) -> int | None:
        """Return the smallest number of steps with a landing, None if there is none.

        An additional step lowers the height at rest by about the distance of the fastest step, so
        the miss indicates how many are lacking.
        """
        steps, drop = self._straight_drop()
        short, enough, miss = 0, 0, np.nan
        while not enough or enough - short > 1:
            plan = self._plan(steps)
            if plan is not None and plan.miss < _LANDS:
                enough = steps
            elif steps >= self._most:
                return None
            else:
                before, short = short, steps
                if plan is not None and np.isfinite(miss):
                    drop = max((miss - plan.miss) / (short - before), 0.1 * drop)
                miss = np.nan if plan is None else plan.miss
            steps = (short + max(1, int(miss / drop)) if np.isfinite(miss)
                     else int(_GROWTH * short) + 1)
            if enough and steps >= enough:
                steps = enough - 1 if steps == enough else (short + enough) // 2
            steps = min(steps, self._most)
        # A number of steps that just suffices may fail once all corrections have converged.
        while enough <= self._most:
            exact = self.exact(enough)
            if exact is not None and exact.miss < _LANDS:
                return enough
            enough += 1
        return None

    def _straight_drop(self) -> tuple[int, float]:
        """Return the steps of a straight drop, and the distance of its fastest step, m.

        Without drag, and with the deceleration of the dry mass, so that the steps are too few.
        """
        v = self._program.vehicle
        braking = max(v.max_thrust / v.dry_mass - v.gravity, 0.1 * v.gravity)
        down = -float(self._velocity[1])
        peak = np.sqrt(
            (2 * float(self._position[1]) + down**2 / v.gravity) / (1 / v.gravity + 1 / braking))
        seconds = max(peak - down, 0.0) / v.gravity + peak / braking
        return min(max(int(seconds / v.dt), 1), self._most), _FASTER * float(peak) * v.dt

    def least_fuel(self, least: int) -> int:
        """Return the number of steps with the least fuel, from the smallest with a landing on."""
        low = middle = least
        high = least + 1
        while self._spent(high) < self._spent(middle):
            low, middle, high = middle, high, high + 2 * (high - low)
        while high - low > 2:
            probe = self._valley(low, middle, high)
            if probe == middle or not low < probe < high:
                probe = middle + 1 if high - middle > middle - low else middle - 1
            if self._spent(probe) < self._spent(middle):
                low, middle, high = (
                    (low, probe, middle) if probe < middle else (middle, probe, high))
            else:
                low, high = (probe, high) if probe < middle else (low, probe)
        return middle

    def _valley(self, low: int, middle: int, high: int) -> int:
        """Return the minimum of the parabola through the fuel of three numbers of steps."""
        left, right = ((self._spent(step) - self._spent(middle)) / (step - middle)
                       for step in (low, high))
        bend = (right - left) / (high - low)
        slope = left + bend * (middle - low)
        if not (np.isfinite(slope) and bend > 0):
            return middle
        return round(middle - slope / (2 * bend))

    def _spent(self, steps: int) -> float:
        """Return w at the end of the plan for `steps` steps, m/s; infinite if there is none."""
        plan = self._plan(steps) if steps <= self._most else None
        return float(plan.spent[-1]) if plan is not None else np.inf

    def _plan(self, steps: int) -> Plan | None:
        """Return the plan for `steps` steps, with sufficient accuracy for comparisons."""
        if steps not in self._plans:
            self._plans[steps] = self._solve(steps, _SETTLED)
        return self._plans[steps]

    def exact(self, steps: int) -> Plan | None:
        """Return the plan for `steps` steps, iterated to convergence."""
        if steps not in self._exact:
            known = self._plan(steps)
            self._last = known or self._last
            self._exact[steps] = self._solve(steps, _EXACT) or known
        return self._exact[steps]

    def _solve(self, steps: int, tolerance: float) -> Plan | None:
        """Return a plan whose corrections have converged to the tolerance, m and m/s."""
        program = self._program
        if self._last is None:
            spent, correction = np.zeros(program.blocks), np.zeros((program.blocks, 7))
        else:
            spent = self._last.spent[:-1]
            correction = program.correction(self._last, steps)
        for _ in range(_REPEATS):
            plan = program.solve(self._position, self._velocity, steps, spent, correction)
            if plan is None:
                return None
            self._last = plan
            before, correction = correction, program.correction(plan, steps)
            spent = plan.spent[:-1]
            if np.abs(correction - before).max() <= tolerance:
                break
        return plan
