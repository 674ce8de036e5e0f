# SPDX-License-Identifier: Apache-2.0
"""Free memory between used pieces goes back to the system."""
from __future__ import annotations

import re
from pathlib import Path

import pytest

from rocket_sim_node import free_memory

PIECES, SIZE = 4000, 50_000
"""bytes; smaller than what the C library takes from the system one by one"""


def used() -> float:
    """Return the memory of this process that is no file's, MB."""
    found = re.search(r'RssAnon:\s+(\d+) kB', Path('/proc/self/status').read_text())
    assert found
    return int(found[1]) / 1000


@pytest.mark.skipif(free_memory._TRIM is None, reason='not with this C library')
def test_free_memory_goes_back_to_the_system() -> None:
    pieces = [bytearray(b'x') * SIZE for _ in range(PIECES)]
    kept = pieces[::4]
    full = used()
    del pieces
    before = used()
    free_memory.give_back()
    after = used()
    assert len(kept) == PIECES / 4
    assert before - after > 0.4 * PIECES * SIZE / 1e6, (full, before, after)


def test_free_memory_is_returned_once_in_a_period(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, given = [100.0], []
    monkeypatch.setattr('time.monotonic', lambda: clock[0])
    monkeypatch.setattr(free_memory, 'give_back', lambda: given.append(clock[0]))
    now_and_then = free_memory.PeriodicTrim()
    for clock[0] in (100.0, 109.9, 110.0, 110.1, 119.9, 125.0, 134.9, 135.0):
        now_and_then()
    assert given == [110.0, 125.0, 135.0]
