# SPDX-License-Identifier: Apache-2.0
"""Actions are checked once, here, before anything flies on them."""
from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import WorldSpec


@lru_cache(maxsize=16)
def _bounds(
    low: tuple[float, ...], high: tuple[float, ...], num_envs: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Of the batch's shape: broadcasting a row of three to N would loop N times over three.
    return np.tile(low, (num_envs, 1)), np.tile(high, (num_envs, 1))


def checked_action(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return the batch's actions, clipped to their bounds.

    :param action: `(N, A)` numbers when the world is continuous, `(N,)` whole numbers otherwise.
    :return: `(N, A)` float64, or `(N,)` int64.
    :raises ValueError: when shape or kind is wrong or a value is not finite or no action; the
        message names row, column and value.
    """
    action = np.asarray(action)
    if spec.continuous:
        shape: tuple[int, ...] = (spec.num_envs, len(spec.action_names))
        if action.shape != shape or action.dtype.kind not in 'fiu':
            raise ValueError(
                f'action: got {action.dtype} of shape {action.shape}, '
                f'expected numbers of shape {shape}'
            )
        if not np.isfinite(action).all():
            row, column = np.argwhere(~np.isfinite(action))[0]
            raise ValueError(
                f'action: row {row}, {spec.action_names[column]!r} is '
                f'{action[row, column]}, expected a finite number'
            )
        low, high = _bounds(spec.action_low, spec.action_high, spec.num_envs)
        clipped = np.maximum(action.astype(np.float64), low)
        np.minimum(clipped, high, out=clipped)
        return clipped
    if action.shape != (spec.num_envs,) or action.dtype.kind not in 'iu':
        raise ValueError(
            f'action: got {action.dtype} of shape {action.shape}, '
            f'expected whole numbers of shape {(spec.num_envs,)}'
        )
    if ((action < 0) | (action >= spec.action_count)).any():
        row = int(np.argmax((action < 0) | (action >= spec.action_count)))
        raise ValueError(
            f'action: row {row} is {action[row]}, expected 0 to {spec.action_count - 1}'
        )
    return action.astype(np.int64)
