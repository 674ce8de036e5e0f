# SPDX-License-Identifier: Apache-2.0
"""Engines of the lunar lander: throttle from commands, force and torque on the hull."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings

FEW = 8
"""Maximum number of landers for which formulas are faster with Python's numbers, lander by lander,
than with arrays of all: an operation of NumPy takes half a microsecond, however few they are.
Only operations whose results are the same bits either way are used; NumPy's sine is not."""


class Engines:
    """Main and side engines of N landers.

    As in Gymnasium, an engine's impulse is proportional to its point of action relative to the
    hull's origin; that point, and with it size and direction, is scattered at every step.
    """

    def __init__(self, settings: LunarSettings) -> None:
        """Take the engines' powers from the settings."""
        self._continuous = settings.continuous
        self._main_power = settings.main_engine_power / settings.dt
        self._side_power = settings.side_engine_power / settings.dt
        self.max_thrust = self._main_power * vehicle.MAIN_ENGINE_OFFSET
        """N, without scatter."""
        self.max_lateral_thrust = self._side_power * vehicle.SIDE_ENGINE_AWAY
        """N, without scatter."""
        self._main_of = np.array((0.0, 0.0, 1.0, 0.0))
        self._side_of = np.array((0.0, -1.0, 0.0, 1.0))

    def throttles(self, command: NDArray[Any]) -> tuple[F64, F64]:
        """Return the throttles: main 0 to 1, and side -1 (left engine) to 1 (right), `(N,)` each.

        Continuous commands have dead zones: the main engine is off up to 0 and then runs from 50 %
        to 100 %; side engines are off within plus or minus 0.5.
        """
        if not self._continuous:
            return self._main_of[command], self._side_of[command]
        main, side = command.T
        return (
            np.where(main > 0.0, 0.5 + 0.5 * main, 0.0),
            np.where(np.abs(side) > 0.5, side, 0.0))

    def push(
        self, sin: F64, cos: F64, main: F64, side: F64, scatter: F64, force: F64,
    ) -> None:
        """Compute force and torque at the centres of gravity of the hulls' bodies.

        :param sin: `(N,)` and `cos` `(N,)` of the hulls' angles.
        :param main: `(N,)` and `side` `(N,)` as `throttles` returns them.
        :param scatter: `(2, N)` random numbers, -1 to 1.
        :param force: `(N, 3)` N, N, N m: output.
        """
        arrays = sin, cos, main, side, np.sign(side), *(scatter * vehicle.DISPERSION)
        if len(force) > FEW:
            force[:, 0], force[:, 1], force[:, 2] = self._pushed(*arrays)
        else:
            force[:] = [
                self._pushed(*each)
                for each in zip(*(array.tolist() for array in arrays), strict=True)]

    def _pushed(
        self, sin: Any, cos: Any, main: Any, side: Any, sign: Any, along: Any, across: Any,
    ) -> tuple[Any, Any, Any]:
        """Return force along x and y, N, and torque, N m, of one lander or of `(N,)`.

        :param sign: of `side`.
        :param along: scatter of the points of action along the hull's axis, m.
        :param across: the same across it.
        """
        # Points of action from the hull's origin: tip (sin, cos), side (-cos, sin).
        reach = vehicle.MAIN_ENGINE_OFFSET + 2 * along
        x, y = sin * reach - cos * across, -cos * reach - sin * across
        power = -self._main_power * main
        centre_x, centre_y = -sin * vehicle.BODY_CENTRE, cos * vehicle.BODY_CENTRE
        force_x, force_y = power * x, power * y
        torque = (x - centre_x) * force_y - (y - centre_y) * force_x
        reach = 3 * across + sign * vehicle.SIDE_ENGINE_AWAY
        x, y = sin * along - cos * reach, -cos * along - sin * reach
        power = -self._side_power * abs(side)
        side_x, side_y = power * x, power * y
        x = x - sin * vehicle.SIDE_ENGINE_SKEW
        y = y + cos * vehicle.SIDE_ENGINE_HEIGHT
        torque = torque + ((x - centre_x) * side_y - (y - centre_y) * side_x)
        return force_x + side_x, force_y + side_y, torque


def side_torque(force: F64, sin: F64, cos: F64) -> F64:
    """Return the torque of the side engines about the hulls' origins, without scatter, `(N,)` N m.

    :param force: `(N,)` N, along the hull's x.
    :param sin: `(N,)` and `cos` `(N,)` of the hulls' angles.
    """
    # Height and skew of the points of action are along the axes of the world.
    torque: F64 = -force * (
        vehicle.SIDE_ENGINE_SKEW * sin * sin + vehicle.SIDE_ENGINE_HEIGHT * cos * cos)
    return torque
