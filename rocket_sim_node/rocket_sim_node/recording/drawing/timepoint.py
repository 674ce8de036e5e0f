# SPDX-License-Identifier: Apache-2.0
"""Positions on the timelines of a recording."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording.trajectories.world_info import WorldInfo

PAUSE = 2.0
"""Pause, s, after a flight before the next one begins, for the viewer's benefit."""


def pause_steps(info: WorldInfo) -> int:
    """Return the number of steps between the end of a flight and the start of the next."""
    return int(np.ceil(PAUSE / info.dt))


@dataclass(frozen=True)
class Timepoint:
    """A position on the timelines: step and training iteration.

    Without reports of an agent there is no iteration, and nothing is logged on that timeline.
    Steps are counted by the recording, in which flights follow one another, not by a simulator;
    `sim_time` is the step times dt.
    """

    step: int
    iteration: int | None = None

    def times(self, offsets: NDArray[Any], dt: float) -> list[rr.TimeColumn]:
        """Return the time columns of rows at `offsets` `(k,)` steps from the start."""
        return timelines(self.step + offsets, dt)


def timelines(steps: NDArray[Any], dt: float) -> list[rr.TimeColumn]:
    """Return the time columns of rows at steps `(k,)` of a recording."""
    # Rounded to the nanosecond: Rerun would truncate the product of floats.
    times = np.round(steps * (dt * 1e9)).astype('timedelta64[ns]')
    return [rr.TimeColumn('sim_time', duration=times), rr.TimeColumn('step', sequence=steps)]


def changed(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which rows of `(n, k)` differ from the previous one; the first always does."""
    return np.append(True, np.any(np.diff(values, axis=0) != 0, axis=1))
