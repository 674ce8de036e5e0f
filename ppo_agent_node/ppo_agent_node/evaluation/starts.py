# SPDX-License-Identifier: Apache-2.0
"""Initial conditions of episodes in physical units, decoded from their first observations."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.lunar import view

Columns = dict[str, F64]


def initial_conditions(
    spec: WorldSpec, observation: NDArray[np.float32], settings: Mapping[str, float],
) -> Columns:
    """Return the initial conditions of K episodes, `(K,)` each; names include units.

    Rockets: height of the vehicle's origin, speed downwards, horizontal offset from the pad,
    horizontal drift, tilt from vertical, spin. `lunar_lander`: the velocity of the push, and
    with a `spawn_reach` the height above touchdown. Unknown worlds: their observations, by name.

    :param observation: `(K, D)` the first of each episode.
    :param settings: of the world during the evaluation.
    """
    seen = dict(zip(spec.observation_names, observation.astype(np.float64).T, strict=True))
    if spec.name.startswith('rocket'):
        return _rocket(seen, settings)
    if spec.name == 'lunar_lander':
        x, y = view.seen_velocity(observation)
        push = {'start_velocity_x_m_s': x, 'start_velocity_y_m_s': y,
                'start_speed_m_s': np.hypot(x, y)}
        if not settings.get('spawn_reach'):
            return push
        return {'start_height_m': view.seen_height(observation), **push}
    return {f'start_{name}': values for name, values in seen.items()}


def start_height(seen: F64, settings: Mapping[str, float]) -> F64:
    """Return the heights of rockets' starts, m, from their observed heights `(K,)`.

    Without a `spawn_reach` all begin at the same height, at which an observation may be clipped.
    With one, the height is NaN where it is clipped.
    """
    if not settings['spawn_reach']:
        return np.full_like(seen, settings['spawn_height'])
    return np.where(
        np.abs(seen) < settings['observation_limit'], settings['position_scale'] * seen, np.nan)


def _rocket(seen: Columns, settings: Mapping[str, float]) -> Columns:
    """Return the initial conditions of rockets from scaled and clipped observations."""
    metres, speed = settings['position_scale'], settings['velocity_scale']
    return {
        'start_height_m': start_height(seen['position_y'], settings),
        'start_descent_m_s': -speed * seen['velocity_y'],
        'start_offset_m': metres * np.hypot(seen['position_x'], seen['position_z']),
        'start_drift_m_s': speed * np.hypot(seen['velocity_x'], seen['velocity_z']),
        'start_tilt_deg': np.rad2deg(
            np.arctan2(np.hypot(seen['up_x'], seen['up_z']), seen['up_y'])),
        'start_spin_rad_s': settings['spin_scale'] * np.sqrt(
            seen['spin_x']**2 + seen['spin_y']**2 + seen['spin_z']**2),
    }
