# SPDX-License-Identifier: Apache-2.0
"""Signals request a stop: polled, or raised in code that cannot poll."""
from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest

from rocket_sim_node.wire.node import stopping
from rocket_sim_node.worlds import EnvironmentClosed

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def listening() -> Iterator[None]:
    """Listen, and leave the signals of this process as they were."""
    before = [signal.getsignal(number) for number in SIGNALS]
    stopping.listen()
    yield
    stopping.listen()
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize('number', SIGNALS)
def test_a_signal_requests_a_stop(number: signal.Signals) -> None:
    assert not stopping.requested()
    signal.raise_signal(number)
    signal.raise_signal(number)
    assert stopping.requested()


@pytest.mark.timeout(20)
def test_a_signal_may_interrupt_the_signal_handler_at_any_line() -> None:
    lines = []

    def interrupt(frame: FrameType, event: str, argument: Any) -> Any:
        if event == 'line':
            lines.append(frame.f_lineno)
            signal.raise_signal(signal.SIGTERM)
        return interrupt

    before = sys.gettrace()
    sys.settrace(interrupt)
    try:
        signal.raise_signal(signal.SIGINT)
    finally:
        sys.settrace(before)
    assert lines and stopping.requested()


def test_an_ignored_hang_up_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    stopping.listen()
    signal.raise_signal(signal.SIGHUP)
    assert not stopping.requested()


def test_a_signal_interrupts_abandonable_work_and_nothing_else() -> None:
    done = []

    def work() -> int:
        done.append('begun')
        if len(done) > 1:
            signal.raise_signal(signal.SIGTERM)
            done.append('went on')
        return 7

    assert stopping.abandonable(work) == 7
    with pytest.raises(EnvironmentClosed):
        stopping.abandonable(work)
    assert done == ['begun', 'begun']
    # Asked to end already: not even begun. And outside of it a signal interrupts nothing.
    with pytest.raises(EnvironmentClosed):
        stopping.abandonable(work)
    assert done == ['begun', 'begun']
    signal.raise_signal(signal.SIGTERM)


def test_errors_of_the_work_are_passed_on() -> None:
    with pytest.raises(ZeroDivisionError):
        stopping.abandonable(lambda: 1 // 0)
    signal.raise_signal(signal.SIGTERM)


def test_a_signal_that_python_swallows_still_ends_the_work(
        monkeypatch: pytest.MonkeyPatch) -> None:
    swallowed = []
    monkeypatch.setattr('sys.unraisablehook', swallowed.append)

    class Loud:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)

    def work() -> None:
        Loud()

    with pytest.raises(EnvironmentClosed):
        stopping.abandonable(work)
    assert len(swallowed) == 1
