# SPDX-License-Identifier: Apache-2.0
"""An agent is killed at each of nine moments of its training, and the run is resumed each time.

`test_faults.py` kills at random moments, most of which are steps. Here are the others: as a stage
begins, as its result is saved, and between the two.
"""
from __future__ import annotations

import signal
from pathlib import Path

import pytest
from support.processes import Processes
from support.training.faults import Moments
from support.training.faults import Training
from support.training.training_runs import assert_same_run
from support.training.training_runs import train_in_process

MOMENTS = (
    'run /', 'expert flies 1/', 'cloning 1/', 'DAgger round 1', 'saved cloned.safetensors',
    'PPO 0/', 'checkpoints/iteration_000002', 'evaluating 1/', 'computing figures')
"""what the agent prints, in this order"""
ROUNDS = 20
LONGEST_WAIT = 0.02
"""s from a moment to the kill"""
HANGS = 120.0
"""s after which an agent that does not reach its next moment is given up"""


@pytest.mark.timeout(7200)
def test_a_training_killed_at_each_moment_learns_the_same(
        processes: Processes, tmp_path: Path, nightly: bool) -> None:
    if not nightly:
        pytest.skip('180 kills in 20 trainings: --nightly')
    undisturbed = train_in_process(tmp_path / 'undisturbed')
    moments = Moments()
    for number in range(ROUNDS):
        training = Training(processes, tmp_path / f'run_{number}', moments, plots=True)
        for text in MOMENTS:
            training.agent.wait_for(text, HANGS)
            moments.wait(LONGEST_WAIT)
            training.agent.signal(signal.SIGKILL)
            assert training.agent.wait(5.0) == -signal.SIGKILL, text
            training.restart(training.agent)
        training.finish(HANGS)
        assert_same_run(training.run, undisturbed)
        assert training.assert_recordings_readable()
