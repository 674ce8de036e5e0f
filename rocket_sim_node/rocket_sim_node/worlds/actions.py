# SPDX-License-Identifier: Apache-2.0
"""Actions are checked once, here, before anything flies on them."""
from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import WorldSpec

_LARGEST = float(np.finfo(np.float32).max)


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
    if not spec.continuous:
        return _choices(spec, np.asarray(action))
    low, high = _bounds(spec.action_low, spec.action_high, spec.num_envs)
    clipped = np.maximum(_finite(spec, np.asarray(action)).astype(np.float64), low)
    np.minimum(clipped, high, out=clipped)
    return clipped


def idle_action(spec: WorldSpec) -> NDArray[Any]:
    """Return the batch's actions where nobody gives any, as `checked_action` would."""
    if not spec.continuous:
        return np.full(spec.num_envs, int(spec.action_idle[0]))
    return np.tile(np.array(spec.action_idle, np.float64), (spec.num_envs, 1))


def commanded(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return the batch's actions as they travel: checked, not clipped.

    Who flies them clips them, and counts what was beyond the bounds.

    :param action: as for `checked_action`, which makes the same of what is returned here.
    :return: `(N, A)` float32, or `(N,)` int64.
    :raises ValueError: as `checked_action`.
    """
    action = np.asarray(action)
    if not spec.continuous:
        return _choices(spec, action)
    if _finite(spec, action).dtype == np.float32:
        return action
    return np.clip(action.astype(np.float64), -_LARGEST, _LARGEST).astype(np.float32)


def _finite(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return continuous actions once they are known to be finite numbers, one for each entry."""
    shape = (spec.num_envs, len(spec.action_names))
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
    return action


def _choices(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return discrete actions once they are known to be there."""
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


class Clipped:
    """How many commands were beyond their bounds, by axis, and which one the last time."""

    def __init__(self, spec: WorldSpec) -> None:
        """Begin with none."""
        self._spec = spec
        self._counts = np.zeros(len(spec.action_names), np.int64)
        self._last: tuple[NDArray[Any], NDArray[Any]] | None = None

    def note(self, given: NDArray[Any], flown: NDArray[Any]) -> bool:
        """Compare a batch's actions as they came with what `checked_action` made of them.

        :return: whether there was something to clip.
        """
        if not self._spec.continuous:
            return False
        beyond = given != flown
        if not beyond.any():
            return False
        self._counts += beyond.sum(axis=0)
        self._last = given, beyond
        return True

    @property
    def counts(self) -> dict[str, int]:
        """How many, by name of the axis; a command is a value of one rocket for one axis."""
        return dict(zip(self._spec.action_names, self._counts.tolist(), strict=True))

    @property
    def last(self) -> str:
        """Row, axis, value and bounds of the last one; empty before the first."""
        if self._last is None:
            return ''
        given, beyond = self._last
        row, axis = np.argwhere(beyond)[-1].tolist()
        return (
            f'row {row}, {self._spec.action_names[axis]!r} is {given[row, axis]:g}, expected '
            f'{self._spec.action_low[axis]:g} to {self._spec.action_high[axis]:g}')
