# SPDX-License-Identifier: Apache-2.0
"""Parallel execution of two computations, each with half of the tensor library's threads."""
from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import wait
from contextlib import contextmanager
from typing import TypeVar

import torch

from ppo_agent_node.threads import tensor_threads

A = TypeVar('A')
B = TypeVar('B')
P = TypeVar('P')
Poll = Callable[[], None]
Begin = Callable[[Callable[[], None]], Callable[[], object]]
"""Starts a computation; returns a function that waits for its end, and raises its exceptions."""


class _Stopped(Exception):
    """The other computation ended with an error."""


def both(first: Callable[[Poll], A], second: Callable[[Poll], B], poll: Poll) -> tuple[A, B]:
    """Run two independent computations in parallel and return both results.

    Two independent threads use two cores better than one computation whose every operation is
    shared between them. With one thread available they run one after the other; results with one
    thread each are identical, bit for bit.

    :param first: runs in this thread. Both must call the function they receive regularly, and let
        its exceptions through.
    :param poll: called in this thread only; when it raises, both end.
    """
    threads = torch.get_num_threads()
    if threads == 1:
        return first(poll), second(poll)
    stop = threading.Event()

    def poll_second() -> None:
        if stop.is_set():
            raise _Stopped

    with tensor_threads(threads - threads // 2), ThreadPoolExecutor(
            1, initializer=torch.set_num_threads, initargs=(threads // 2,)) as pool:
        future = pool.submit(second, poll_second)
        try:
            result = first(poll)
            while not future.done():
                poll()
                wait([future], timeout=0.02)
        except BaseException:
            stop.set()
            raise
    return result, future.result()


@contextmanager
def second_thread() -> Iterator[Begin]:
    """Yield a function that begins a short computation in a second thread, beside this one.

    Each of the two has half of the threads. With one thread available, the computation runs at
    once, in this one.
    """
    threads = torch.get_num_threads()

    def run_now(compute: Callable[[], None]) -> Callable[[], object]:
        compute()
        return lambda: None

    if threads == 1:
        yield run_now
        return
    with tensor_threads(threads - threads // 2), ThreadPoolExecutor(
            1, initializer=torch.set_num_threads, initargs=(threads // 2,)) as pool:
        yield lambda compute: pool.submit(compute).result


def in_halves(
    begin: Begin, pieces: Sequence[P], first: Callable[[Sequence[P]], None],
    second: Callable[[Sequence[P]], None],
) -> None:
    """Process the first half of the pieces, and the second half by `begin`; return after both.

    :raises BaseException: of the first that failed; the second has ended then, too.
    """
    half = -(-len(pieces) // 2)
    wait_for_second = begin(lambda: second(pieces[half:]))
    try:
        first(pieces[:half])
    except BaseException:
        with contextlib.suppress(Exception):
            wait_for_second()
        raise
    wait_for_second()
