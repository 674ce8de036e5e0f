# SPDX-License-Identifier: Apache-2.0
"""Engines of the lunar lander: throttle from commands, force and torque on the hull."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings


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

    def push(self, hull: F64, main: F64, side: F64, scatter: F64, force: F64) -> None:
        """Compute force and torque at the centres of gravity of the hulls' bodies.

        :param hull: `(N, 3)` poses of the hulls: m, m, rad.
        :param main: `(N,)` and `side` `(N,)` as `throttles` returns them.
        :param scatter: `(2, N)` random numbers, -1 to 1.
        :param force: `(N, 3)` N, N, N m: output.
        """
        sin, cos = np.sin(hull[:, 2]), np.cos(hull[:, 2])
        along, across = scatter * vehicle.DISPERSION
        # Points of action from the hull's origin: tip (sin, cos), side (-cos, sin).
        reach = vehicle.MAIN_ENGINE_OFFSET + 2 * along
        x, y = sin * reach - cos * across, -cos * reach - sin * across
        power = -self._main_power * main
        centre_x, centre_y = -sin * vehicle.BODY_CENTRE, cos * vehicle.BODY_CENTRE
        force_x, force_y = power * x, power * y
        torque = (x - centre_x) * force_y - (y - centre_y) * force_x
        reach = 3 * across + np.sign(side) * vehicle.SIDE_ENGINE_AWAY
        x, y = sin * along - cos * reach, -cos * along - sin * reach
        power = -self._side_power * np.abs(side)
        side_x, side_y = power * x, power * y
        x -= sin * vehicle.SIDE_ENGINE_SKEW
        y += cos * vehicle.SIDE_ENGINE_HEIGHT
        torque += (x - centre_x) * side_y - (y - centre_y) * side_x
        np.add(force_x, side_x, out=force[:, 0])
        np.add(force_y, side_y, out=force[:, 1])
        force[:, 2] = torque
