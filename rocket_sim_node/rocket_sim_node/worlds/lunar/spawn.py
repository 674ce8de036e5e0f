# SPDX-License-Identifier: Apache-2.0
"""Initial states of `lunar_lander` episodes: terrain, pad, and a push in a random direction."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import start_heights
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.pymunk_batch.lanes import Lanes

_HEIGHTS = 12
DRAWS = _HEIGHTS + 4
"""Numbers of an episode's stream used for its start; the engines' scatter uses the following."""
_PAD = slice(3, 8)
"""Terrain points that Gymnasium levels: 11 points, with the pad in the middle."""
_WIND_PLACES = 9999
_TERRAIN, _POSE, _VELOCITY, _WIND = slice(0, 11), slice(11, 20), slice(20, 29), slice(29, 31)
"""Columns of a stored start."""


_EDGES = np.linspace(-vehicle.HALF_WIDTH, vehicle.HALF_WIDTH, 11).tolist()


class LanderStart(NamedTuple):
    """Initial states of K episodes."""

    terrain: F64
    """`(K, 11)` m above the floor."""
    pose: F64
    """`(K, 3, 3)` m, m, rad of hull, left leg, right leg."""
    velocity: F64
    """`(K, 3, 3)` m/s, m/s, rad/s."""
    wind: F64
    """`(2, K)` initial phases of the patterns of wind and turbulence."""
    key: NDArray[np.uint64]
    """`(K,)` streams of the episodes; the engines' scatter uses them from number DRAWS on."""


def _pushed() -> tuple[float, float, float]:
    """Return the velocity change by 1 N s along x or y at the hull's centre: m/s, m/s; rad/s.

    While the push acts the legs are as Gymnasium creates them and the joints hold: one rigid
    body, whose centre of gravity lies below the hull's. A push along y has the same effect, but
    does not turn it.
    """
    leg_y = vehicle.leg_offset(1.0, vehicle.LEG_PUSHED)
    centre = (
        vehicle.HULL_MASS * vehicle.HULL_CENTRE + 2 * vehicle.LEG_MASS * leg_y[1]
    ) / vehicle.TOTAL_MASS
    above = vehicle.HULL_CENTRE - centre
    moment = (
        vehicle.HULL_MOMENT + vehicle.HULL_MASS * above**2
        + 2 * (vehicle.LEG_MOMENT
               + vehicle.LEG_MASS * (leg_y[0]**2 + (leg_y[1] - centre)**2)))
    turn = -above / moment
    return 1 / vehicle.TOTAL_MASS - turn * above, 1 / vehicle.TOTAL_MASS, turn


_PUSH_X, _PUSH_Y, _PUSH_TURN = _pushed()


_START_HEIGHT = vehicle.START_HEIGHT + vehicle.HULL_CENTRE
"""Height, m, of the hull's own centre of gravity, relative to which the bodies are placed."""
_PLACES = (
    (0.0, vehicle.BODY_CENTRE - vehicle.HULL_CENTRE, 0.0),
    *((x, y - vehicle.HULL_CENTRE, vehicle.SIDE[leg] * vehicle.LEG_START)
      for leg in (vehicle.LEFT, vehicle.RIGHT)
      for x, y in [vehicle.leg_offset(vehicle.SIDE[leg], vehicle.LEG_START)]),
)
"""Poses, m, m, rad, of the bodies when the hull is upright."""


class Starts:
    """Draws the starts of N landers; each is a function of (seed, row, episode)."""

    def __init__(
        self, seed: int, num_envs: int, dt: float, gravity: float, reach: float,
    ) -> None:
        """Prepare; starts are drawn on demand.

        :param reach: m, the setting `spawn_reach`.
        """
        def make(
            rows: NDArray[np.integer], episodes: NDArray[np.integer],
        ) -> tuple[NDArray[np.uint64], F64]:
            key = random_streams.keys(seed, rows, episodes)
            height = reach * start_heights.reach_share(
                seed, rows, episodes) if reach else vehicle.DROP
            return key, derive(random_streams.numbers(key, DRAWS), dt, gravity, height)

        self._drawn = random_streams.DrawnAhead(num_envs, make)

    def take(self, rows: NDArray[np.integer], episodes: NDArray[np.integer]) -> LanderStart:
        """Return the starts of rows' episodes, one step after the push."""
        key, flat = self._drawn.take(rows, episodes)
        return LanderStart(
            flat[:, _TERRAIN], flat[:, _POSE].reshape(-1, 3, 3),
            flat[:, _VELOCITY].reshape(-1, 3, 3), flat[:, _WIND].T, key)


def derive(unit: F64, dt: float, gravity: float, height: F64 | float) -> F64:
    """Return terrain, poses, velocities and wind phases, concatenated `(K, 31)`.

    :param unit: `(16, K)` random numbers in [-1, 1): heights of the terrain, the push along x and
        y, the initial phases of wind and turbulence.
    :param height: `(K,)` or one for all, m above touchdown; the push is in proportion.
    """
    count = unit.shape[1]
    start = np.empty((count, 31))
    start[:, _TERRAIN] = _terrain(unit[:_HEIGHTS])
    push = unit[_HEIGHTS:_HEIGHTS + 2] * vehicle.START_PUSH * dt * (height / vehicle.DROP)
    start[:, _WIND] = np.floor(unit[_HEIGHTS + 2:] * _WIND_PLACES).T
    velocity_x, spin = push[0] * _PUSH_X, push[0] * _PUSH_TURN
    velocity_y = push[1] * _PUSH_Y - gravity * dt
    angle = spin * dt
    sin, cos = np.sin(angle), np.cos(angle)
    pose = start[:, _POSE].reshape(count, 3, 3)
    velocity = start[:, _VELOCITY].reshape(count, 3, 3)
    for body, (x, y, turned) in enumerate(_PLACES):
        arm_x, arm_y = cos * x - sin * y, sin * x + cos * y
        pose[:, body, 0] = velocity_x * dt + arm_x
        pose[:, body, 1] = _START_HEIGHT - (vehicle.DROP - height) + velocity_y * dt + arm_y
        pose[:, body, 2] = angle + turned
        velocity[:, body, 0] = velocity_x - spin * arm_y
        velocity[:, body, 1] = velocity_y + spin * arm_x
        velocity[:, body, 2] = spin
    start[:, _POSE] = pose.reshape(count, 9)
    start[:, _VELOCITY] = velocity.reshape(count, 9)
    return start


def _terrain(unit: F64) -> F64:
    """Return smoothed heights `(K, 11)` of the ground from numbers `(12, K)` in [-1, 1)."""
    height = (unit + 1) * (vehicle.HALF_HEIGHT / 2)
    height[_PAD] = vehicle.PAD_HEIGHT
    # The first point's left neighbour is the last point, as in Gymnasium.
    smooth = 0.33 * (np.roll(height, 1, axis=0) + height + np.roll(height, -1, axis=0))
    return smooth[:11].T


def shape_ground(lanes: Lanes, row: int, terrain: F64) -> None:
    """Move the ground of a lander's lane to heights `(11,)`."""
    shapes, origin = lanes.ground(row)
    slopes = shapes[:10]
    points = [(origin + x, y) for x, y in zip(_EDGES, terrain.tolist(), strict=True)]
    for shape, left, right in zip(slopes, points[:-1], points[1:], strict=True):
        shape.unsafe_set_endpoints(left, right)
    lanes.reindex(row, slopes)
