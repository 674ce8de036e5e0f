# SPDX-License-Identifier: Apache-2.0
"""Whether rockets that touched down in world `rocket` then stand, by the planar contact model."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.planar.settling import VERDICTS
from rocket_sim_node.worlds.planar.settling import settle

_TOGETHER = 2000
"""touchdowns that are followed at once"""


@dataclass(frozen=True)
class Standing:
    """What became of K episodes; see `rocket_sim_node.worlds.planar.settling` for the model."""

    standing: NDArray[np.bool_]
    """`(K,)`, False for those that never came down, or so fast that legs would give way"""
    verdicts: dict[str, int]
    """touchdowns by what happened then"""
    rest_distance: F64
    """`(J,)` m from the pad's centre, of those that stand"""
    verdict: tuple[str, ...]
    """K names: what happened after the touchdown, '' where there was none"""


def after_touchdown(
    observation: NDArray[np.float32], fuel: F64, ground: NDArray[np.bool_],
    settings: Mapping[str, float], dry_mass_factor: F64, gravity_factor: F64,
) -> Standing:
    """Let the contact model take over from the ends of episodes.

    :param observation: `(K, 15)` or more, the last of each episode. Float32 and without yaw, of
        which neither matters to the model: it stands to 1e-5 m and leaves yaw out.
    :param fuel: `(K,)` kg left in the tank.
    :param ground: `(K,)` which episodes ended on the ground.
    :param settings: of world `rocket`.
    :param dry_mass_factor: `(K,)` what was drawn for the episodes, as `gravity_factor`.
    """
    last = observation[ground].astype(np.float64)
    position = last[:, 0:3] * settings['position_scale']
    velocity = last[:, 3:6] * settings['velocity_scale']
    spin = last[:, 9:12] * settings['spin_scale']
    mass = settings['dry_mass'] * dry_mass_factor[ground] + fuel[ground]
    gravity = settings['gravity'] * gravity_factor[ground]
    # Each has bodies of its own and all its moments, which together would fill the memory.
    parts = [
        settle(position[part], _swing(last[part, 6:9]), velocity[part], spin[part], mass[part],
               settings, gravity=gravity[part])
        for part in (slice(start, start + _TOGETHER)
                     for start in range(0, max(len(last), 1), _TOGETHER))]
    upright, verdict, places = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ('standing', 'verdict', 'position'))
    standing = np.zeros(len(observation), np.bool_)
    # The model's legs hold at any speed; real ones are made for a landing.
    speed = np.linalg.norm(velocity, axis=1)
    stands = upright & (speed < settings['landed_speed'])
    standing[ground] = stands
    rest = places[stands]
    names = np.full(len(observation), '', dtype=object)
    names[ground] = [name for part in parts for name in part.names()]
    return Standing(
        standing,
        {name: int((verdict == code).sum()) for code, name in enumerate(VERDICTS)},
        np.hypot(rest[:, 0], rest[:, 2]), tuple(names.tolist()))


def _swing(up: F64) -> F64:
    """Return the quaternions `(J, 4)` x y z w that turn y up into unit vectors `(J, 3)`.

    The shortest turn: its axis is y x up, its angle the tilt; yaw is 0.
    """
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    half = np.sqrt(np.maximum(0.5 * (1 + up[:, 1]), 1e-12))
    return np.stack(
        (0.5 * up[:, 2] / half, np.zeros(len(up)), -0.5 * up[:, 0] / half, half), axis=1)
