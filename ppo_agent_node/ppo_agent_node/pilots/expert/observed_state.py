# SPDX-License-Identifier: Apache-2.0
"""State of rockets in physical units, decoded from observations."""
from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.planar.vehicle import foot_height


class ObservedState(NamedTuple):
    """State of N rockets as observed, y up."""

    height: F64
    """`(N,)` m to fall; in a world with feet, of the lower foot."""
    origin_height: F64
    """`(N,)` m, height of the vehicle's origin above its standing height."""
    lateral: F64
    """`(2, N)` m from the pad's axis, along x and z."""
    velocity: F64
    """`(3, N)` m/s."""
    up: F64
    """`(3, N)`, the body's axis."""
    spin: F64
    """`(3, N)` rad/s."""

    @property
    def speed(self) -> F64:
        """`(N,)` m/s, downwards."""
        speed: F64 = -self.velocity[1]
        return speed

    @property
    def drift(self) -> F64:
        """`(2, N)` m/s, along x and z."""
        drift: F64 = self.velocity[::2]
        return drift

    @property
    def upright(self) -> F64:
        """`(N,)`, cosine of the tilt, at least 0.1, as a divisor of thrust."""
        upright: F64 = np.maximum(self.up[1], 0.1)
        return upright


def look(observation: F32, settings: Mapping[str, float]) -> ObservedState:
    """Return the state decoded from observations `(N, 15)` of a world of rockets.

    :param settings: of that world.
    """
    seen = observation.T[:15].astype(np.float64)
    up = seen[6:9]
    offset = -seen[12:15] * settings['position_scale']
    height = offset[1]
    if 'stance' in settings:
        origin = height + settings['touchdown_height']
        height = foot_height(origin, np.hypot(up[0], up[2]), up[1], settings)
    return ObservedState(
        height, offset[1], offset[::2], seen[3:6] * settings['velocity_scale'], up,
        seen[9:12] * settings['spin_scale'])
