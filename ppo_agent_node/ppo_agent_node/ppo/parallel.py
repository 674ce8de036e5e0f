# SPDX-License-Identifier: Apache-2.0
"""Two computations at once, each with half of the tensor library's threads."""
from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import wait
from typing import TypeVar

import torch

A = TypeVar('A')
B = TypeVar('B')
Poll = Callable[[], None]


class _Stopped(Exception):
    """The other computation ended with an error."""


def both(first: Callable[[Poll], A], second: Callable[[Poll], B], poll: Poll) -> tuple[A, B]:
    """Return what two computations return that have nothing to do with each other.

    Two threads that never wait for one another use two cores better than one computation whose
    every operation is shared between them. With one thread they run one after the other; what
    they compute with one thread each is the same, bit for bit.

    :param first: runs in this thread. Both call what they are given now and then, and let pass
        what it raises.
    :param poll: is called in this thread only; when it raises, both end.
    """
    threads = torch.get_num_threads()
    if threads == 1:
        return first(poll), second(poll)
    stop = threading.Event()

    def poll_second() -> None:
        if stop.is_set():
            raise _Stopped

    def run_second() -> B:
        torch.set_num_threads(threads // 2)
        return second(poll_second)

    try:
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(run_second)
            try:
                torch.set_num_threads(threads - threads // 2)
                result = first(poll)
                while not future.done():
                    poll()
                    wait([future], timeout=0.02)
            except BaseException:
                stop.set()
                raise
    finally:
        torch.set_num_threads(threads)
    return result, future.result()
