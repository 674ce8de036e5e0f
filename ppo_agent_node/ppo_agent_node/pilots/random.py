# SPDX-License-Identifier: Apache-2.0
"""Random pilot: a first check of a world, and the baseline of every comparison."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import WorldSpec


class RandomPilot:
    """Draws every action uniformly from the action space, regardless of observations."""

    name = 'random'

    def __init__(self, spec: WorldSpec, seed: int = 0) -> None:
        """Start the stream of actions.

        :param spec: the world to fly.
        :param seed: 0 or more; equal seeds and batch sizes give equal actions.
        :raises ValueError: for a negative seed.
        """
        self._spec = spec
        self._generator = np.random.default_rng(seed)

    def __call__(self, observation: F32) -> NDArray[Any]:
        """Return `(N, A)` float32 within the bounds, or `(N,)` int64 below `action_count`."""
        count, spec = len(observation), self._spec
        if not spec.continuous:
            return self._generator.integers(spec.action_count, size=count)
        low = np.array(spec.action_low, np.float32)
        high = np.array(spec.action_high, np.float32)
        unit = self._generator.random((count, spec.action_size), np.float32)
        return low + (high - low) * unit
