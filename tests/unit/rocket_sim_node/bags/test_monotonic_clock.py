# SPDX-License-Identifier: Apache-2.0
"""Times of a bag's messages keep their order and their distances when the clock is set."""
from __future__ import annotations

import time

import pytest

from rocket_sim_node.bags.monotonic_clock import MonotonicClock

DAY = 86_400 * 10**9


@pytest.mark.parametrize('jump', [-DAY, DAY])
def test_a_clock_that_is_set_changes_no_time(monkeypatch: pytest.MonkeyPatch, jump: int) -> None:
    system, slack = time.time_ns, 10**7
    begin = system()
    clock = MonotonicClock()
    first = clock.now()
    end = system()
    assert begin - slack <= first <= end + slack
    monkeypatch.setattr(time, 'time_ns', lambda: system() + jump)
    second = clock.now()
    assert first <= second <= system() + slack
