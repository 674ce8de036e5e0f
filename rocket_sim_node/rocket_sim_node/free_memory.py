# SPDX-License-Identifier: Apache-2.0
"""Memory that is free goes back to the system, also what lies in pieces."""
from __future__ import annotations

import ctypes
import time

PERIOD = 10.0
"""s; how often who runs for days may do that: a call takes a millisecond or a few"""

_TRIM = getattr(ctypes.CDLL(None), 'malloc_trim', None)
"""of glibc; other C libraries have none"""


def give_back() -> None:
    """Give the free memory of this process back to the system, where that can be done.

    Roll-outs and updates allocate arrays of many sizes anew, and DDS what it knows of its peers.
    What they leave free lies in pieces in the heap, into which the next ones do not quite fit, and
    the C library keeps it.
    """
    if _TRIM is not None:
        _TRIM(0)


class PeriodicTrim:
    """Gives free memory back when called, if PERIOD has passed since it last did."""

    def __init__(self) -> None:
        """Begin: the first time is a period from now at the earliest."""
        self._last = time.monotonic()

    def __call__(self) -> None:
        """Give back what is free, if it is time."""
        now = time.monotonic()
        if now - self._last >= PERIOD:
            self._last = now
            give_back()
