# SPDX-License-Identifier: Apache-2.0
"""A training whose processes are killed, stopped and ended; it continues each time."""
from __future__ import annotations

import random
import secrets
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rocket_sim_node.recording.reader import trajectories
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.training.training_runs import fresh_agent
from support.training.training_runs import fresh_simulator

LONGEST_STOP = 2.5
"""s; longer than the time after which a service call is repeated"""
BEGUN = ('waiting for an agent', 'run /', 'recording to')
"""first output of simulator, agent and recorder"""
ENDS = ('resume:=true', 'all files are in', 'stopped before the run began')
"""last output of an agent"""
END = 60.0
"""s; time limit for a process to end after a signal"""


class Moments:
    """Random times and choices, which the printed seed reproduces."""

    def __init__(self, seed: int | None = None) -> None:
        """Draw a seed and print it; pytest shows it if a test fails."""
        self.seed = secrets.randbits(32) if seed is None else seed
        print(f'moments of faults: seed {self.seed}')
        self.random = random.Random(self.seed)

    def wait(self, longest: float) -> None:
        """Wait for up to `longest` s."""
        time.sleep(self.random.uniform(0.0, longest))


class Training:
    """Simulator, agent and recorder of a small training, which are restarted after a fault."""

    def __init__(
        self, processes: Processes, run: Path, moments: Moments, **settings: object,
    ) -> None:
        """Start all three."""
        self.processes, self.run, self.moments = processes, run, moments
        self.recording = run.with_suffix('.rrd')
        self._settings = settings
        self.simulator = fresh_simulator(processes)
        self.recorder = self._start_recorder()
        self.agent = self._start_agent()

    def _start_recorder(self) -> Process:
        return self.processes.run_node(
            'rocket_sim_node', 'rerun_recorder', output=self.recording, every_nth_episode=1,
            crashes=True)

    def _start_agent(self, **settings: object) -> Process:
        self._learnt_before = self._learnt()
        return fresh_agent(self.processes, self.run, **self._settings, **settings)

    def _learnt(self) -> int:
        log = self.run / 'train.jsonl'
        return log.stat().st_mtime_ns if log.exists() else 0

    def learns(self) -> bool:
        """Wait until the agent has learnt since its start or has ended; return whether it runs."""
        wait_until(
            lambda: self._learnt() != self._learnt_before or not self.agent.running, END,
            self.processes.logs)
        return self.agent.running

    def restart(self, process: Process) -> None:
        """Restart a process that has ended."""
        if process is self.simulator:
            self.simulator = fresh_simulator(self.processes)
        elif process is self.recorder:
            self.recorder = self._start_recorder()
        else:
            self.agent = self._start_agent(resume=True)

    # Faults

    def kill(self, process: Process) -> None:
        """Kill a process at once and start it again."""
        process.signal(signal.SIGKILL)
        process.wait(5.0)
        self.restart(process)

    def kill_simulator(self) -> None:
        """Kill the simulator."""
        self.kill(self.simulator)

    def kill_agent(self) -> None:
        """Kill the agent; the run is resumed."""
        self.kill(self.agent)

    def kill_recorder(self) -> None:
        """Kill the recorder; the next one repairs its recording."""
        self.kill(self.recorder)

    def stop_and_continue(self) -> None:
        """Stop the simulator, the agent or both for a while."""
        stopped = self.moments.random.choice(
            [[self.simulator], [self.agent], [self.simulator, self.agent]])
        for process in stopped:
            process.signal(signal.SIGSTOP)
        self.moments.wait(LONGEST_STOP)
        for process in stopped:
            process.signal(signal.SIGCONT)

    def tell_to_end(self, number: signal.Signals) -> None:
        """Send one of the three processes a signal, once or repeatedly; restart the process."""
        random = self.moments.random
        process = random.choice([self.simulator, self.agent, self.recorder])
        for _ in range(random.choice([1, 1, 2, 3])):
            process.signal(number)
            self.moments.wait(random.choice([0.0, 0.05, 0.5]))
        status, output = process.wait(END), process.output()
        if any(word in output for word in BEGUN):
            assert status == 0, output
            assert 'Traceback' not in output, output
            if process is self.agent and self.run.exists():
                assert any(said in output for said in ENDS), output
        else:
            # It was still importing, so the signal itself ends it.
            assert status in (0, 130, -number) or (
                status == 1 and 'KeyboardInterrupt' in output), output
        self.restart(process)

    def interrupt(self) -> None:
        """End one of the processes with SIGINT."""
        self.tell_to_end(signal.SIGINT)

    def terminate(self) -> None:
        """End one of the processes with SIGTERM."""
        self.tell_to_end(signal.SIGTERM)

    # The end

    def finish(self, seconds: float) -> None:
        """Wait for the end of the training, then end recorder and simulator."""
        assert self.agent.wait(seconds) == 0, self.processes.logs()
        for process in (self.recorder, self.simulator):
            process.signal(signal.SIGINT)
            assert process.wait(END) == 0, self.processes.logs()

    def assert_recordings_readable(self) -> int:
        """Assert that each recording is complete; return the total number of flights."""
        stem = self.recording.stem
        files = sorted(self.recording.parent.glob(f'{stem}*.rrd'))
        assert not list(self.recording.parent.glob(f'{stem}*partial*'))
        assert not list(self.recording.parent.glob(f'{stem}*damaged*'))
        flights = 0
        for file in files:
            check = self.processes.start('rerun', 'rrd', 'verify', str(file))
            assert check.wait(30.0) == 0, check.output()
            for flight in trajectories(file):
                assert np.isfinite(flight.position).all()
                flights += 1
        return flights


FAULTS: dict[str, Callable[[Training], None]] = {
    'simulator_killed': Training.kill_simulator,
    'agent_killed': Training.kill_agent,
    'recorder_killed': Training.kill_recorder,
    'stopped_and_continued': Training.stop_and_continue,
    'SIGINT': Training.interrupt,
    'SIGTERM': Training.terminate,
}
