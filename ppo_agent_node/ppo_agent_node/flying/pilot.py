# SPDX-License-Identifier: Apache-2.0
"""What every pilot is: something that looks at a batch of observations and answers actions."""
from __future__ import annotations

from typing import Any
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32


class Pilot(Protocol):
    """A scripted, random or learnt pilot of N rockets.

    One that remembers flights has a method `begin` beside, one that remembers commands a method
    `flew`: see `tell_begun` and `tell_flown`. All who fly a pilot tell it when episodes begin.
    """

    @property
    def name(self) -> str:
        """What tables and files call it."""
        ...

    def __call__(self, observation: F32) -> NDArray[Any]:
        """Answer the actions for a batch.

        :param observation: `(N, D)` float32, as the world gives it.
        :return: `(N, A)` float32 for a continuous world, `(N,)` int64 for a discrete one.
        """
        ...


def tell_begun(pilot: object, rows: NDArray[np.int64] | None = None) -> None:
    """Tell a pilot that remembers flights that it sees the first moment of an episode next.

    :param rows: `(K,)` in which rows; None: in all.
    """
    begin = getattr(pilot, 'begin', None)
    if begin is not None and (rows is None or len(rows)):
        begin(rows)


def tell_flown(pilot: object, action: NDArray[Any]) -> None:
    """Tell a pilot that remembers its commands that another action was flown instead."""
    flew = getattr(pilot, 'flew', None)
    if flew is not None:
        flew(action)
