# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as a wish: what is under way comes to a good end, ROS still being there.

The handlers of rclpy would shut ROS down at once and interrupt Python anywhere, in the midst of a
step or of a write; then nobody could be told, and control not be handed back.
"""
from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rocket_sim_node.worlds.base import EnvironmentClosed

_stop = threading.Event()
_abandon = False


class _Abandoned(BaseException):
    """Not an Exception, so that no library on the way takes it for one of its own."""


def listen() -> None:
    """Take SIGINT and SIGTERM as wishes from now on; further ones change nothing."""
    _stop.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _on_signal)


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _abandon
    _stop.set()
    if _abandon:
        _abandon = False
        raise _Abandoned


def requested() -> bool:
    """Return whether this process has been asked to end."""
    return _stop.is_set()


@contextmanager
def abandoning() -> Iterator[None]:
    """Abandon the work within wherever it is, once this process is asked to end.

    For work that cannot look for itself and of which nothing may be missed, such as drawing.

    :raises EnvironmentClosed: when it was abandoned.
    """
    global _abandon
    try:
        _abandon = True
        if _stop.is_set():
            raise _Abandoned
        yield
    except _Abandoned:
        raise EnvironmentClosed('asked to stop') from None
    finally:
        _abandon = False
    if _stop.is_set():
        raise EnvironmentClosed('asked to stop')
