# SPDX-License-Identifier: Apache-2.0
"""Graceful handling of SIGINT, SIGTERM and SIGHUP: the signal is a request, and ROS stays up.

rclpy's handlers would shut ROS down at once and interrupt Python anywhere, even within a step or a
write. Then peers could not be notified, nor control be released.
"""
from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import TypeVar

from rocket_sim_node.errors import EnvironmentClosed

T = TypeVar('T')

# No threading.Event: if a signal arrives while another signal's handler is inside `set`, the
# second handler would deadlock on the lock that the interrupted one holds.
_stop = False
_abandon = False


class _Abandoned(BaseException):
    """Derived from BaseException, so that libraries do not catch it as an ordinary error."""


def listen() -> None:
    """Treat SIGINT, SIGTERM and SIGHUP as stop requests from now on; repeats have no effect.

    An ignored SIGHUP, as with nohup, stays ignored.
    """
    global _stop
    _stop = False
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _on_signal)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, _on_signal)


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _stop, _abandon
    _stop = True
    if _abandon:
        _abandon = False
        raise _Abandoned


def requested() -> bool:
    """Return whether this process has been asked to stop."""
    return _stop


def abandonable(work: Callable[[], T]) -> T:
    """Run `work` and return its result; abandon it when this process is asked to stop.

    For work that cannot check for a stop request and whose partial results are not needed, such as
    drawing. It is interrupted at any point, except in a `__del__`: Python swallows exceptions
    raised there, so the work runs to its end first.

    :raises EnvironmentClosed: when it was abandoned, or a stop was requested meanwhile.
    """
    global _abandon
    try:
        try:
            _abandon = True
            if _stop:
                raise _Abandoned
            result = work()
        finally:
            _abandon = False
    except _Abandoned:
        raise EnvironmentClosed('asked to stop') from None
    if _stop:
        raise EnvironmentClosed('asked to stop')
    return result
