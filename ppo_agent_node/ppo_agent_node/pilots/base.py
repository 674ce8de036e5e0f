# SPDX-License-Identifier: Apache-2.0
"""What every pilot is: something that looks at a batch of observations and answers actions."""
from __future__ import annotations

from typing import Any
from typing import Protocol

from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F32


class Pilot(Protocol):
    """A scripted, random or learnt pilot of N rockets."""

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
