# SPDX-License-Identifier: Apache-2.0
"""Soft landing in a given number of steps, as a second-order cone program.

Lossless convexification (Acikmese and Ploen, 'Convex programming approach to powered descent
guidance for Mars landing', Journal of Guidance, Control, and Dynamics 30, 2007): the acceleration
u = T / m replaces the thrust T, a variable sigma >= |u| its magnitude, and the mass is replaced by
the velocity that the burned fuel could buy, w = v_e ln(m_0 / m). Then the motion is linear, and

    sigma <= F_max / m_0 e^(w / v_e)

is the only bound that is not convex. It is replaced by its tangent, which lies below. The
nonlinear rest of the motion, drag and the mass change within a block of steps, is added as a
constant computed from the previous solution: see `LandingProgram.correction`.

The thrust is held over blocks of steps. Each block advances as the world does in as many steps.
"""
from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ppo_agent_node.evaluation.optimum.point_mass import F64
from ppo_agent_node.evaluation.optimum.point_mass import PointMass

TOUCH_SPEED = 0.01
"""m/s, downwards at touchdown: at rest it would have reached that height a step earlier."""
_WIDTH = 11
"""Variables of a block: u (3) and sigma during it, position (3), velocity (3) and w after it."""
_SIGMA, _POSITION, _VELOCITY, _W = 3, 4, 7, 10
_MISS_COST = 50.0
"""m/s of w per metre of height missed: a penalty far above the cost of descending."""
_SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)


@dataclass(frozen=True)
class Plan:
    """A solution of the program, K blocks."""

    acceleration: F64
    """`(K, 3)` m/s^2, thrust over mass."""
    position: F64
    """`(K + 1, 3)` m from the target point on the pad, at the ends of blocks."""
    velocity: F64
    """`(K + 1, 3)` m/s."""
    spent: F64
    """`(K + 1,)` m/s, w."""
    miss: float
    """m, height above the pad at which it comes to rest; 0 if the steps suffice."""


class LandingProgram:
    """The program of one vehicle; start, steps and corrections vary between solves."""

    def __init__(self, vehicle: PointMass, blocks: int, tilt_limit: float) -> None:
        """Define variables and constraints.

        :param blocks: K.
        :param tilt_limit: deg, maximum tilt of the thrust.
        """
        self.vehicle, self.blocks = vehicle, blocks
        self._lean = float(np.cos(np.deg2rad(tilt_limit)))
        self._most_spent = vehicle.exhaust_speed * np.log(vehicle.mass / vehicle.dry_mass)
        self._solver: clarabel.DefaultSolver | None = None

    def lengths(self, steps: int) -> NDArray[np.int64]:
        """Return the number of steps of each block, `(K,)`, as equal as integers allow."""
        ends = np.linspace(0, steps, self.blocks + 1).astype(np.int64)
        lengths: NDArray[np.int64] = np.diff(ends)
        return lengths

    def solve(
        self, position: F64, velocity: F64, steps: int, spent: F64, correction: F64,
    ) -> Plan | None:
        """Return the best landing after `steps` steps, None if there is none.

        :param position: `(3,)` m from the target point on the pad.
        :param velocity: `(3,)` m/s.
        :param spent: `(K,)` m/s, w at which the thrust bound is linearised.
        :param correction: `(K, 7)` changes of position, velocity and w in each block beside the
            linear motion.
        """
        matrix, bound = self._matrix(steps, spent), self._bound(
            position, velocity, steps, spent, correction)
        if self._solver is None:
            self._solver = self._make(matrix, bound)
        else:
            self._solver.update(A=matrix, b=bound)
        solution = self._solver.solve()
        if solution.status not in _SOLVED:
            return None
        x = np.array(solution.x)
        blocks = x[:-1].reshape(self.blocks, _WIDTH)
        return Plan(
            acceleration=blocks[:, :3],
            position=np.vstack((position, blocks[:, _POSITION:_VELOCITY])),
            velocity=np.vstack((velocity, blocks[:, _VELOCITY:_W])),
            spent=np.append(0.0, blocks[:, _W]), miss=max(float(x[-1]), 0.0))

    def thrust(self, plan: Plan) -> F64:
        """Return the thrust of each block, `(K, 3)` N, held while the mass falls."""
        return plan.acceleration * self._mass(plan)[:, None]

    def correction(self, plan: Plan, steps: int) -> F64:
        """Return the difference of the world's motion from the linear one in each block.

        All blocks are simulated at once, each from its own beginning.

        :param steps: of the flight; those of the plan, or others to which it is to be stretched.
        :return: `(K, 7)` of position, m, velocity, m/s, and w, m/s.
        """
        v, lengths = self.vehicle, self.lengths(steps)
        time, weight = (part[:, None] for part in self._times(steps))
        u, thrust = plan.acceleration - (0.0, v.gravity, 0.0), self.thrust(plan)
        position, velocity, mass = plan.position[:-1], plan.velocity[:-1], self._mass(plan)
        linear = np.column_stack((
            position + velocity * time + u * weight, velocity + u * time,
            plan.spent[:-1] + np.linalg.norm(plan.acceleration, axis=1) * time[:, 0]))
        for step in range(int(lengths.max())):
            flies = step < lengths
            after = v.step(position, velocity, mass, thrust)
            position = np.where(flies[:, None], after[0], position)
            velocity = np.where(flies[:, None], after[1], velocity)
            mass = np.where(flies, after[2], mass)
        spent = v.exhaust_speed * np.log(v.mass / mass)
        correction: F64 = np.column_stack((position, velocity, spent)) - linear
        return correction

    def _mass(self, plan: Plan) -> F64:
        """Return the mass at the beginning of each block, `(K,)` kg."""
        mass: F64 = self.vehicle.mass * np.exp(-plan.spent[:-1] / self.vehicle.exhaust_speed)
        return mass

    def _times(self, steps: int) -> tuple[F64, F64]:
        """Return the durations of blocks, s, and the displacement per unit acceleration, s^2."""
        count: F64 = (self.lengths(steps) * self.vehicle.substeps).astype(np.float64)
        dt = self.vehicle.dt / self.vehicle.substeps
        time: F64 = count * dt
        return time, count * (count + 1) * (0.5 * dt**2)

    def _tangent(self, spent: F64) -> tuple[F64, F64]:
        """Return value at w = 0 and slope of the tangents to the bound of sigma, `(K,)`."""
        v = self.vehicle
        bound = v.max_thrust / v.mass * np.exp(spent / v.exhaust_speed)
        return bound * (1 - spent / v.exhaust_speed), bound / v.exhaust_speed

    def _matrix(self, steps: int, spent: F64) -> sparse.csc_array:
        """Return the constraint matrix; its sparsity pattern is the same for all arguments."""
        k, time = self.blocks, self._times(steps)
        _, slope = self._tangent(spent)
        one, block = np.ones(k), np.arange(k)
        end = k * _WIDTH
        entries: list[tuple[NDArray[np.int64], NDArray[np.int64], F64]] = []
        height = 0

        def rows(count: int, *terms: tuple[int, F64, int]) -> None:
            """Add rows for the blocks after the first k - count: (column, values, blocks back)."""
            nonlocal height
            for column, values, back in terms:
                chosen = block[max(k - count, back):]
                entries.append((
                    height + chosen - (k - count), (chosen - back) * _WIDTH + column,
                    values[chosen]))
            height += count

        # Equalities: the motion of position, velocity and w, then the end.
        for axis in range(3):
            position, velocity = _POSITION + axis, _VELOCITY + axis
            rows(k, (position, one, 0), (position, -one, 1), (velocity, -time[0], 1),
                 (axis, -time[1], 0))
        for axis in range(3):
            velocity = _VELOCITY + axis
            rows(k, (velocity, one, 0), (velocity, -one, 1), (axis, -time[0], 0))
        rows(k, (_W, one, 0), (_W, -one, 1), (_SIGMA, -time[0], 0))
        entries.append((np.array([height + 1]), np.array([end]), -one[:1]))
        for column in range(_POSITION, _W):
            rows(1, (column, one, 0))
        # Inequalities: the bound of sigma, the tilt, the ground, the fuel, the miss.
        rows(k, (_SIGMA, one, 0), (_W, -slope, 1))
        rows(k, (_SIGMA, self._lean * one, 0), (1, -one, 0))
        rows(k - 1, (_POSITION + 1, -one, 1))
        rows(1, (_W, one, 0))
        entries.append((np.array([height]), np.array([end]), -one[:1]))
        height += 1
        # Cones: |u| <= sigma.
        for place, column in enumerate((_SIGMA, 0, 1, 2)):
            entries.append((height + 4 * block + place, block * _WIDTH + column, -one))
        row, place_in_row, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        shape = height + 4 * k, end + 1
        return sparse.coo_array((value, (row, place_in_row)), shape).tocsc()

    def _bound(
        self, position: F64, velocity: F64, steps: int, spent: F64, correction: F64,
    ) -> F64:
        """Return the right-hand side of the constraints."""
        v, k = self.vehicle, self.blocks
        time, weight = self._times(steps)
        motion = correction.copy()
        motion[:, 1] -= v.gravity * weight
        motion[:, 4] -= v.gravity * time
        motion[0, :3] += position + velocity * time[0]
        motion[0, 3:6] += velocity
        touch = (0.0, -0.5 * TOUCH_SPEED * v.dt, 0.0, 0.0, -TOUCH_SPEED, 0.0)
        thrust, _ = self._tangent(spent)
        return np.concatenate((
            motion.T.ravel(), touch, thrust, np.zeros(2 * k - 1), [self._most_spent, 0.0],
            np.zeros(4 * k)))

    def _make(self, matrix: sparse.csc_array, bound: F64) -> clarabel.DefaultSolver:
        """Return a solver whose data can be replaced."""
        k = self.blocks
        cost = np.zeros(matrix.shape[1])
        cost[-2:] = 1.0, _MISS_COST
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False
        settings.max_threads = 1
        cones = [
            clarabel.ZeroConeT(7 * k + 6), clarabel.NonnegativeConeT(3 * k + 1),
            *[clarabel.SecondOrderConeT(4)] * k]
        quadratic = sparse.csc_array((len(cost), len(cost)))
        return clarabel.DefaultSolver(quadratic, cost, matrix, bound, cones, settings)
