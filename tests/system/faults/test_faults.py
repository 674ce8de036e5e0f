# SPDX-License-Identifier: Apache-2.0
"""Processes of a training are killed, stopped or ended at random moments; nothing is lost.

Each fault 50 times while it learns and 10 times at any moment, mostly while something starts, with
`--nightly`; else each once, while it learns. `test_endings.py` ends nodes that start.
"""
from __future__ import annotations

import signal
import time
from collections import deque
from pathlib import Path

import pytest
from support.processes import Processes
from support.training.faults import FAULTS
from support.training.faults import Moments
from support.training.faults import Training
from support.training.training_runs import assert_same_run
from support.training.training_runs import train_in_process

SETTINGS = {'iterations': 24, 'selection_interval': 8}
ROUNDS = {True: 1, False: 0}
NIGHTLY_ROUNDS = {True: 50, False: 10}
"""of each fault: while the agent learns, and at any moment"""
PER_RUN = 12
"""faults in one training, which is then left to finish"""
LONGEST_WAIT = {True: 0.5, False: 2.0}
"""s from when the agent learns again, or from the fault before: often a process still starts"""

FROZEN = 25.0
"""s; DDS takes a participant for gone that was silent for 20"""
HANGS = 400.0
"""s after which a training without further faults is given up"""

pytestmark = pytest.mark.timeout(1800)


def faults_of(names: list[str], rounds: dict[bool, int]) -> list[tuple[str, bool]]:
    """Return faults, each with whether the agent shall be learning."""
    return [(name, learning) for learning, count in rounds.items() for name in names * count]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Take the faults one by one where there is time, else all together."""
    if 'faults' in metafunc.fixturenames:
        if metafunc.config.getoption('--nightly'):
            sets = [faults_of([name], NIGHTLY_ROUNDS) for name in FAULTS]
            metafunc.parametrize('faults', sets, ids=FAULTS)
        else:
            metafunc.parametrize('faults', [faults_of([*FAULTS], ROUNDS)], ids=['all_in_turn'])


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run in one process, without ROS and without faults."""
    return train_in_process(tmp_path_factory.mktemp('undisturbed') / 'run', **SETTINGS)


def test_training_continues_and_learns_the_same(
        processes: Processes, tmp_path: Path, undisturbed: Path,
        faults: list[tuple[str, bool]]) -> None:
    moments = Moments()
    coming = deque(moments.random.sample(faults, len(faults)))
    runs = flights = 0
    while coming:
        runs += 1
        training = Training(processes, tmp_path / f'run_{runs}', moments, **SETTINGS)
        for _ in range(min(PER_RUN, len(coming))):
            name, learning = coming[0]
            if learning and not training.learns():
                break
            moments.wait(LONGEST_WAIT[learning])
            if not training.agent.running:
                break
            coming.popleft()
            FAULTS[name](training)
        training.finish(HANGS)
        assert_same_run(training.run, undisturbed)
        flights += training.assert_recordings_readable()
    assert flights
    during = sum(learning for _, learning in faults)
    print(f'{len(faults)} faults, {during} of them while the agent learnt, in {runs} trainings; '
          f'{flights} flights recorded')


def test_suspending_all_processes_beyond_their_patience_changes_nothing(
        processes: Processes, tmp_path: Path, undisturbed: Path, nightly: bool) -> None:
    """As by `docker pause`: longer than the agent's patience and the discovery lease of DDS."""
    if not nightly:
        pytest.skip('a minute of standing still: --nightly')
    training = Training(processes, tmp_path / 'run', Moments(), patience=5.0, **SETTINGS)
    training.agent.wait_for('PPO 2/', HANGS)
    everybody = training.simulator, training.agent, training.recorder
    for _ in range(2):
        for process in everybody:
            process.signal(signal.SIGSTOP)
        time.sleep(FROZEN)
        for process in everybody:
            process.signal(signal.SIGCONT)
        time.sleep(max(LONGEST_WAIT.values()))
    training.finish(HANGS)
    assert_same_run(training.run, undisturbed)
