# SPDX-License-Identifier: Apache-2.0
"""Spaces of observations and actions, with the bounds that the worlds keep."""
from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32

_UNIT = ('right_contact', 'left_contact')
"""Columns that are 0 or 1."""


def observation_bounds(spec: WorldSpec) -> tuple[F32, F32]:
    """Return the least and the greatest value of each column of an observation, `(D,)` each.

    Worlds of rockets clip all columns to their setting `observation_limit`; past commands stay
    within the bounds of actions. In `lunar_lander` nothing but the contacts is bounded.
    """
    size = spec.observation_size
    high = np.full(size, spec.settings.get('observation_limit', np.inf), np.float32)
    low = -high
    for column, name in enumerate(spec.observation_names):
        if name in _UNIT:
            low[column], high[column] = 0.0, 1.0
        elif name.startswith('command_'):
            axis = next(a for a, axis in enumerate(spec.action_names) if name.endswith(axis))
            low[column] = max(low[column], spec.action_low[axis])
            high[column] = min(high[column], spec.action_high[axis])
    return low, high


def observation_space(spec: WorldSpec) -> spaces.Box:
    """Return the space of one environment's observations, `(D,)` float32."""
    low, high = observation_bounds(spec)
    return spaces.Box(low, high, dtype=np.float32)


def action_space(spec: WorldSpec) -> spaces.Space[Any]:
    """Return the space of one environment's actions: a box `(A,)` of float32, or whole numbers."""
    if not spec.continuous:
        return spaces.Discrete(spec.action_count)
    return spaces.Box(
        np.array(spec.action_low, np.float32), np.array(spec.action_high, np.float32))
