# SPDX-License-Identifier: Apache-2.0
"""Pilot interface: maps a batch of observations to actions."""
from __future__ import annotations

from typing import Any
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32


class Pilot(Protocol):
    """A scripted, random or learned pilot of N rockets.

    A pilot that remembers flights also has a method `begin`, one that remembers commands a method
    `flew`: see `tell_begun` and `tell_flown`. Callers must notify it when episodes begin.
    """

    @property
    def name(self) -> str:
        """Its name in tables and files."""
        ...

    def __call__(self, observation: F32) -> NDArray[Any]:
        """Return the actions for a batch.

        :param observation: `(N, D)` float32, as the world returns it.
        :return: `(N, A)` float32 for a continuous world, `(N,)` int64 for a discrete one.
        """
        ...


def tell_begun(pilot: object, rows: NDArray[np.int64] | None = None) -> None:
    """Notify a pilot that remembers flights that episodes begin with the next observation.

    :param rows: `(K,)` rows in which they begin; None: all.
    """
    begin = getattr(pilot, 'begin', None)
    if begin is not None and (rows is None or len(rows)):
        begin(rows)


def tell_flown(pilot: object, action: NDArray[Any]) -> None:
    """Notify a pilot that remembers its commands that another action was applied instead."""
    flew = getattr(pilot, 'flew', None)
    if flew is not None:
        flew(action)
