# SPDX-License-Identifier: Apache-2.0
"""Steps of the system clock are noticed, and objects that wait are woken."""
from __future__ import annotations

import gc
import threading
import time
import weakref

import pytest

from rocket_sim_node.wire.node import clock_steps

PATIENCE = 10.0


class Sleeper:
    """An object that counts how often it was woken."""

    def __init__(self) -> None:
        self.woken = threading.Semaphore(0)

    def wake(self) -> None:
        self.woken.release()


@pytest.mark.parametrize('step', [-86_400.0, -1.0, 3_600.0])
def test_a_step_of_the_clock_wakes_waiting_objects(
        monkeypatch: pytest.MonkeyPatch, step: float) -> None:
    real, offset = time.time, 0.0
    monkeypatch.setattr(clock_steps.time, 'time', lambda: real() + offset)
    watch, sleeper, other = clock_steps.Watch(), Sleeper(), Sleeper()
    watch.add(sleeper, Sleeper.wake)
    watch.add(other, Sleeper.wake)
    gone = other.woken
    del other
    gc.collect()
    assert not sleeper.woken.acquire(timeout=0.5)
    offset = step
    assert sleeper.woken.acquire(timeout=PATIENCE)
    assert not sleeper.woken.acquire(timeout=0.5)  # once for each step
    assert not gone.acquire(blocking=False)


def test_a_failing_object_does_not_stop_others_and_none_is_kept_alive(
        monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing:
        def wake(self) -> None:
            raise RuntimeError('gone')

    real, offset = time.time, 0.0
    monkeypatch.setattr(clock_steps.time, 'time', lambda: real() + offset)
    watch, sleeper, failing = clock_steps.Watch(), Sleeper(), [Failing(), Failing()]
    for one in (failing[0], sleeper, failing[1]):
        watch.add(one, type(one).wake)
    for _ in range(2):
        offset -= 3600.0
        assert sleeper.woken.acquire(timeout=PATIENCE)
    kept = weakref.ref(sleeper)
    del one, sleeper
    failing.clear()
    gc.collect()
    assert kept() is None
