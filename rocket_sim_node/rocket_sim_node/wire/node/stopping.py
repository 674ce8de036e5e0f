# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C, SIGTERM and SIGHUP as a wish: what is under way comes to a good end, with ROS there.

The handlers of rclpy would shut ROS down at once and interrupt Python anywhere, in the midst of a
step or of a write; then nobody could be told, and control not be handed back.
"""
from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import TypeVar

from rocket_sim_node.errors import EnvironmentClosed

T = TypeVar('T')

# No threading.Event: a signal that arrives while the handler of another one is within `set` would
# wait there for ever for the lock that the interrupted handler holds.
_stop = False
_abandon = False


class _Abandoned(BaseException):
    """Not an Exception, so that no library on the way takes it for one of its own."""


def listen() -> None:
    """Take SIGINT, SIGTERM and SIGHUP as wishes from now on; further ones change nothing.

    A SIGHUP that is ignored, as nohup has it, stays so.
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
    """Return whether this process has been asked to end."""
    return _stop


def abandonable(work: Callable[[], T]) -> T:
    """Do some work and return what it does; abandon it once this process is asked to end.

    For work that cannot look for itself and of which nothing may be missed, such as drawing. It
    is left wherever it is, but for a signal inside a `__del__`: Python swallows what is raised
    there, so that the work goes on to its end first.

    :raises EnvironmentClosed: when it was abandoned, or asked for meanwhile.
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
