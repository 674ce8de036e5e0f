# SPDX-License-Identifier: Apache-2.0
"""Expert with a memory; its caller reports applied actions and new episodes."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.memory import FlightMemory
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import WorldSpec


class StatefulExpert(ExpertPilot):
    """Lands rockets, and remembers the flight of each row; see :class:`FlightMemory`.

    Subclasses use the memory, and update it with their observations.
    """

    def __init__(self, spec: WorldSpec, **gains: float) -> None:
        """Take the vehicle from the world's settings and the gains from the caller.

        :raises ValueError: as :class:`ExpertPilot` does.
        """
        super().__init__(spec, **gains)
        self._memory = FlightMemory(self.vehicle)
        self._flown: F32 | None = None

    def __call__(self, observation: F32) -> F32:
        """Return actions `(N, 3)`, as :class:`ExpertPilot` does."""
        if self._flown is not None and len(self._flown) == len(observation):
            self._note(self._flown)
        self._flown = super().__call__(observation)
        return self._flown

    def flew(self, action: F32) -> None:
        """Record that another action `(N, 3)` was applied than the last one returned."""
        self._flown = np.clip(action, -1.0, 1.0)

    def begin(self, rows: NDArray[np.int64] | None = None) -> None:
        """Note that the next call has the first observation of an episode.

        :param rows: `(K,)` rows; None: all.
        """
        self._memory.begin(rows)

    def _note(self, action: F32) -> None:
        """Record the action `(N, 3)` applied since the last call."""
        self._memory.command((action[:, 0].astype(np.float64) + 1) / 2)
