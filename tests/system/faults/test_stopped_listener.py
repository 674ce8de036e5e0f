# SPDX-License-Identifier: Apache-2.0
"""A subscriber that is stopped by Ctrl-Z or a debugger does not block other nodes."""
from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.processes import Processes

STOPS, NIGHTLY_STOPS = 2, 60
STILL = 1.5
"""s for which the recorder is stopped"""


@pytest.mark.timeout(600)
def test_a_stopped_recorder_does_not_block_other_nodes(
        processes: Processes, make_client: Callable[..., Any], tmp_path: Path,
        nightly: bool) -> None:
    processes.run_node('rocket_sim_node', 'simulator', num_envs=256)
    recorder = processes.run_node(
        'rocket_sim_node', 'rerun_recorder', output=tmp_path / 'run.rrd', max_steps=10_000)
    recorder.wait_for('recording to', 30.0)
    client = make_client(patience=15.0)
    client.reset(1)
    action = np.zeros((256, 3), np.float32)

    def fly(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for _ in range(20):
                client.step(action)
            client.snapshot()

    for _ in range(NIGHTLY_STOPS if nightly else STOPS):
        recorder.signal(signal.SIGSTOP)
        try:
            fly(STILL)
        finally:
            recorder.signal(signal.SIGCONT)
        fly(0.5)
    recorder.signal(signal.SIGINT)
    assert recorder.wait(20.0) == 0
    assert (tmp_path / 'run.rrd').is_file()
