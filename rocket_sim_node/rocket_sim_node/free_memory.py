# SPDX-License-Identifier: Apache-2.0
"""Return of free, fragmented heap memory to the operating system."""
from __future__ import annotations

import ctypes
import time

PERIOD = 10.0
"""Seconds between calls in long-running processes: a call takes a few milliseconds."""

_TRIM = getattr(ctypes.CDLL(None), 'malloc_trim', None)
"""A function of glibc; other C libraries lack it."""


def give_back() -> None:
    """Return free memory of this process to the operating system, where that is supported.

    Roll-outs and updates allocate arrays of many sizes, and DDS allocates records of its peers.
    The memory they free is fragmented: later arrays do not quite fit, and the C library keeps it.
    """
    if _TRIM is not None:
        _TRIM(0)


class PeriodicTrim:
    """Returns free memory when called, at most once per PERIOD."""

    def __init__(self) -> None:
        """Start the first period."""
        self._last = time.monotonic()

    def __call__(self) -> None:
        """Return free memory if the period has passed."""
        now = time.monotonic()
        if now - self._last >= PERIOD:
            self._last = now
            give_back()
