# SPDX-License-Identifier: Apache-2.0
"""Packets lost between two hosts cost a little time and no step."""
from __future__ import annotations

import pytest
from benchmarks.wire.loss import HEAD
from benchmarks.wire.loss import line
from benchmarks.wire.loss import measure
from support.network.hosts import missing_loss

N = 64
P99 = 20.0
"""ms that a step may take, 99 times in 100, while one packet in a hundred is lost: the median of
stretches of a flight"""
BUSY = 3.0
"""times what a step takes without losses that it may take instead, where that is more: on a
machine that has much else to do"""
FLIGHTS = 4
"""at most: it may have so much to do in one or the other"""

pytestmark = pytest.mark.timeout(1800)


@pytest.mark.skipif(bool(missing_loss()), reason=missing_loss())
@pytest.mark.parametrize('share', [0.01, 0.05])
def test_no_step_is_lost_or_taken_twice(share: float, nightly: bool) -> None:
    for flight in range(1, FLIGHTS + 1):
        figures = measure(share, N, 1500, 50 if nightly else 1)
        print(f'{HEAD}\n{line(share, figures)}')
        assert figures['lost'] == pytest.approx(share * figures['packets'], rel=0.5)
        assert figures['steps'] == figures['asked']
        assert figures['equal']
        if share != 0.01 or figures['typical_p99'] <= P99:
            break
        without = measure(0.0, N, 1500, 1)
        if figures['typical_p99'] <= BUSY * without['typical_p99']:
            break
        assert flight < FLIGHTS, (figures, without)
