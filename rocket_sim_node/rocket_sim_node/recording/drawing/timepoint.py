# SPDX-License-Identifier: Apache-2.0
"""Places on the timelines of a recording."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording.trajectories.world_info import WorldInfo

PAUSE = 2.0
"""s of standing still after a flight, for the eye, before the next one begins"""


def pause_steps(stage: WorldInfo) -> int:
    """Return how many steps lie between the end of a flight and the start of the next."""
    return int(np.ceil(PAUSE / stage.dt))


@dataclass(frozen=True)
class Timepoint:
    """Where on the timelines something lies: its first step and the training iteration.

    Where no agent has reported there is no iteration, and nothing lies on that timeline.
    Steps count those of the recording, in which flights lie one after another, and not those of
    a simulator; `sim_time` is the step times dt.
    """

    step: int
    iteration: int | None = None

    def times(self, offsets: NDArray[Any], dt: float) -> list[rr.TimeColumn]:
        """Return the time columns of rows at `offsets` `(k,)` steps from the start."""
        return timelines(self.step + offsets, dt)


def timelines(steps: NDArray[Any], dt: float) -> list[rr.TimeColumn]:
    """Return the time columns of rows at steps `(k,)` of a recording."""
    # To the nanosecond: Rerun would cut off what a product of floats lacks.
    times = np.round(steps * (dt * 1e9)).astype('timedelta64[ns]')
    return [rr.TimeColumn('sim_time', duration=times), rr.TimeColumn('step', sequence=steps)]


def changed(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which rows of `(n, k)` differ from the one before; the first always does."""
    return np.append(True, np.any(np.diff(values, axis=0) != 0, axis=1))
