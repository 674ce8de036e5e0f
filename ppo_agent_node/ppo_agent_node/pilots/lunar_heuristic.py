# SPDX-License-Identifier: Apache-2.0
"""Scripted pilot of `lunar_lander`: Gymnasium's heuristic, vectorised."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import WorldSpec

_NOTHING, _LEFT, _MAIN, _RIGHT = range(4)


class LunarHeuristic:
    """Leans towards the pad, and holds a height in proportion to the distance from it.

    The control law and its gains are those of `heuristic` in Gymnasium's
    `envs/box2d/lunar_lander.py` (Farama Foundation, version 1.4). A `Pilot`.
    """

    name = 'heuristic'

    def __init__(self, spec: WorldSpec) -> None:
        """Store the kind of action.

        :raises ValueError: when the world is not `lunar_lander`.
        """
        if spec.name != 'lunar_lander':
            raise ValueError(f'heuristic pilot: world is {spec.name!r}, expected lunar_lander')
        self._continuous = spec.continuous

    def __call__(self, observation: F32) -> NDArray[Any]:
        """Return `(N, 2)` float32 or `(N,)` int64 actions for observations `(N, 8)`."""
        x, y, velocity_x, velocity_y, angle, spin, leg_1, leg_2 = observation.astype(np.float64).T
        wanted_angle = np.clip(0.5 * x + velocity_x, -0.4, 0.4)
        turn = 0.5 * (wanted_angle - angle) - spin
        climb = 0.5 * (0.55 * np.abs(x) - y) - 0.5 * velocity_y
        standing = (leg_1 > 0) | (leg_2 > 0)
        turn = np.where(standing, 0.0, turn)
        climb = np.where(standing, -0.5 * velocity_y, climb)
        if self._continuous:
            action = np.clip(np.stack((20 * climb - 1, -20 * turn), axis=1), -1, 1)
            flown: NDArray[np.float32] = action.astype(np.float32)
            return flown
        return np.select(
            [(climb > np.abs(turn)) & (climb > 0.05), turn < -0.05, turn > 0.05],
            [_MAIN, _RIGHT, _LEFT], _NOTHING).astype(np.int64)
