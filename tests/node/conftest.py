# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of nodes."""
from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.nodes.falling_rockets import Simulator
from support.processes import Processes


@pytest.fixture
def simulator(processes: Processes, monkeypatch: pytest.MonkeyPatch) -> Iterator[Simulator]:
    """Return a simulator in this process, whose rockets fall."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    simulator = Simulator(processes.domain)
    yield simulator
    simulator.end()
