# SPDX-License-Identifier: Apache-2.0
"""Validation and clipping of a batch's actions."""
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
    # Arrays of the batch's shape: broadcasting a row of three to N would loop N times over three.
    return np.tile(low, (num_envs, 1)), np.tile(high, (num_envs, 1))


def checked_action(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return the batch's actions, clipped to their bounds.

    :param action: `(N, A)` numbers when the world is continuous, `(N,)` integers otherwise.
    :return: `(N, A)` float64, or `(N,)` int64.
    :raises ValueError: for a wrong shape or type, a value that is not finite, or an unknown
        discrete action; the message names row, column and value.
    """
    if not spec.continuous:
        return _choices(spec, np.asarray(action))
    low, high = _bounds(spec.action_low, spec.action_high, spec.num_envs)
    clipped = np.maximum(_finite(spec, np.asarray(action)).astype(np.float64), low)
    np.minimum(clipped, high, out=clipped)
    return clipped


def idle_action(spec: WorldSpec) -> NDArray[Any]:
    """Return the idle actions of the batch, in the form of `checked_action`."""
    if not spec.continuous:
        return np.full(spec.num_envs, int(spec.action_idle[0]))
    return np.tile(np.array(spec.action_idle, np.float64), (spec.num_envs, 1))


def commanded(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return the batch's actions as sent to a simulator: validated, not clipped.

    The simulator clips them, and counts values beyond the bounds.

    :param action: as for `checked_action`, whose result for the returned array is the same.
    :return: `(N, A)` float32, or `(N,)` int64.
    :raises ValueError: as `checked_action`.
    """
    action = np.asarray(action)
    if not spec.continuous:
        return _choices(spec, action)
    if _finite(spec, action).dtype == np.float32:
        return action
    return np.clip(action.astype(np.float64), -_LARGEST, _LARGEST).astype(np.float32)


def check_form(action: NDArray[Any], shape: tuple[int, ...], *, continuous: bool) -> None:
    """Check the shape and the type of actions.

    :param shape: the expected one.
    :raises ValueError: for another one, or a type that is not of numbers.
    """
    kinds, numbers = ('fiu', 'numbers') if continuous else ('iu', 'whole numbers')
    if action.shape != shape or action.dtype.kind not in kinds:
        raise ValueError(
            f'action: got {action.dtype} of shape {action.shape}, '
            f'expected {numbers} of shape {shape}')


def _finite(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return continuous actions after checking their shape and that they are finite."""
    check_form(action, (spec.num_envs, len(spec.action_names)), continuous=True)
    if not np.isfinite(action).all():
        row, column = np.argwhere(~np.isfinite(action))[0]
        raise ValueError(
            f'action: row {row}, {spec.action_names[column]!r} is '
            f'{action[row, column]}, expected a finite number'
        )
    return action


def _choices(spec: WorldSpec, action: NDArray[Any]) -> NDArray[Any]:
    """Return discrete actions after checking that they exist."""
    check_form(action, (spec.num_envs,), continuous=False)
    if ((action < 0) | (action >= spec.action_count)).any():
        row = int(np.argmax((action < 0) | (action >= spec.action_count)))
        raise ValueError(
            f'action: row {row} is {action[row]}, expected 0 to {spec.action_count - 1}'
        )
    return action.astype(np.int64)


class Clipped:
    """Number of clipped commands by axis, and a description of the last one."""

    def __init__(self, spec: WorldSpec) -> None:
        """Initialise the counts to 0."""
        self._spec = spec
        self._counts = np.zeros(len(spec.action_names), np.int64)
        self._last: tuple[NDArray[Any], NDArray[Any]] | None = None

    def note(self, given: NDArray[Any], flown: NDArray[Any]) -> bool:
        """Compare a batch's actions before and after `checked_action`.

        :return: whether any value was clipped.
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
        """Counts by axis name; a command is one rocket's value for one axis."""
        return dict(zip(self._spec.action_names, self._counts.tolist(), strict=True))

    @property
    def last(self) -> str:
        """Row, axis, value and bounds of the last clipped command; empty if there is none."""
        if self._last is None:
            return ''
        given, beyond = self._last
        row, axis = np.argwhere(beyond)[-1].tolist()
        return (
            f'row {row}, {self._spec.action_names[axis]!r} is {given[row, axis]:g}, expected '
            f'{self._spec.action_low[axis]:g} to {self._spec.action_high[axis]:g}')
