# SPDX-License-Identifier: Apache-2.0
"""Simulation of whether rockets stand after a touchdown in world `rocket`."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.planar.settling import VERDICTS
from rocket_sim_node.worlds.planar.settling import settle

_TOGETHER = 2000
"""Number of touchdowns simulated at once."""


@dataclass(frozen=True)
class Standing:
    """Results of K episodes; see `rocket_sim_node.worlds.planar.settling` for the model."""

    standing: NDArray[np.bool_]
    """`(K,)`, False without a touchdown, or if it was so fast that legs would break."""
    verdicts: dict[str, int]
    """Number of touchdowns by verdict."""
    rest_distance: F64
    """`(J,)` m from the pad's centre, of standing rockets."""
    verdict: tuple[str, ...]
    """K verdicts, '' without a touchdown."""


def is_clipped(observation: NDArray[np.float32], settings: Mapping[str, float]) -> bool:
    """Return whether observations of touchdowns are clipped, so that they hide the motion.

    :param observation: `(J, 15)` or more.
    :param settings: of world `rocket`.
    """
    limit = np.float32(settings['observation_limit'])
    # A limit of 1 or more does not clip the unit vector, whose entries may be exactly 1.
    columns = [*range(0, 6), *range(9, 12), *(range(6, 9) if limit < 1 else ())]
    return bool((np.abs(observation[:, columns]) >= limit).any())


def after_touchdown(
    observation: NDArray[np.float32], fuel: F64, ground: NDArray[np.bool_],
    settings: Mapping[str, float], dry_mass_factor: F64, gravity_factor: F64,
) -> Standing:
    """Continue episodes from their ends with the contact model.

    :param observation: `(K, 15)` or more, the last of each episode, not clipped at touchdowns. In
        float32 and without yaw, which does not matter: the model is accurate to 1e-5 m and ignores
        yaw.
    :param fuel: `(K,)` kg left in the tank.
    :param ground: `(K,)` whether episodes ended on the ground.
    :param settings: of world `rocket`.
    :param dry_mass_factor: `(K,)` drawn for the episodes, like `gravity_factor`.
    """
    last = observation[ground].astype(np.float64)
    position = last[:, 0:3] * settings['position_scale']
    velocity = last[:, 3:6] * settings['velocity_scale']
    spin = last[:, 9:12] * settings['spin_scale']
    mass = settings['dry_mass'] * dry_mass_factor[ground] + fuel[ground]
    gravity = settings['gravity'] * gravity_factor[ground]
    # In batches: each has its own bodies and a full trajectory, too much memory for all at once.
    parts = [
        settle(position[part], _swing(last[part, 6:9]), velocity[part], spin[part], mass[part],
               settings, gravity=gravity[part])
        for part in (slice(start, start + _TOGETHER)
                     for start in range(0, max(len(last), 1), _TOGETHER))]
    upright, verdict, places = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ('standing', 'verdict', 'position'))
    standing = np.zeros(len(observation), np.bool_)
    # The model's legs hold at any speed; real ones do not.
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
    """Return the quaternions `(J, 4)` x y z w that rotate y up to unit vectors `(J, 3)`.

    The shortest rotation: its axis is y x up, its angle the tilt; yaw is 0.
    """
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    half = np.sqrt(np.maximum(0.5 * (1 + up[:, 1]), 1e-12))
    return np.stack(
        (0.5 * up[:, 2] / half, np.zeros(len(up)), -0.5 * up[:, 0] / half, half), axis=1)
