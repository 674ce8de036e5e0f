# SPDX-License-Identifier: Apache-2.0
"""Clock for the times of a bag's messages, which runs on evenly if the system time is set."""
from __future__ import annotations

import time


class MonotonicClock:
    """Times of the day, ns since the epoch, which keep their order if the system time is set."""

    def __init__(self) -> None:
        """Take the system time as it is now."""
        self._start = time.time_ns() - self._steady()

    @staticmethod
    def _steady() -> int:
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)  # runs on while the machine is suspended

    def now(self) -> int:
        """Return the time."""
        return self._start + self._steady()
