# SPDX-License-Identifier: Apache-2.0
"""Starts, kills, stops and restarts the nodes of a soak."""
from __future__ import annotations

import random
import signal
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any
from typing import NamedTuple

from support.processes import Process
from support.processes import Processes

START = 120.0
"""time limit for a node to start, s"""
_END = 20.0
"""time limit for a node to end, s"""
_RECORDED = 20_000
"""maximum number of recorded steps, half of them while an agent learns"""
_PAUSE = 3.0
"""s; how long a node is stopped"""
_FIRST_PAUSE = 90.0
"""s for which recorders are stopped at first. Meanwhile DDS queues messages for them, up to the
history depth of each topic, and keeps the memory of the queue. This fills the queues once;
otherwise they would grow at later stops, on a faster machine, which would look like a slow leak.
Two messages of `state` arrive per second, and its depth is a hundred."""


class Fault(NamedTuple):
    """A fault of a node, and its frequency relative to the others."""

    what: str
    node: str
    weight: int
    until: float = 1.0
    """part of the soak after which the fault no longer occurs"""


NODES = ('sim_0', 'sim_1', 'recorder_0', 'recorder_1', 'agent')
FAULTS = (
    Fault('killed', 'sim_1', 4), Fault('killed', 'recorder_1', 2),
    Fault('killed', 'agent', 3, until=1 / 3), *(Fault('stopped', node, 1) for node in NODES))
"""`sim_0` and `recorder_0` are never killed, and one agent lives for two thirds of the soak: long
enough to reveal leaks."""
YOUNG = tuple(
    fault.node for fault in FAULTS if fault.what == 'killed' and fault.until == 1.0)
"""nodes that are killed throughout, so none of their processes gets old"""


class Nodes:
    """Two simulators, an agent that trains in both, and a recorder for each."""

    def __init__(self, folder: Path, seed: int, num_envs: int, n_steps: int) -> None:
        """Prepare the nodes without starting them."""
        self.processes = Processes(folder)
        self.run = folder / 'run'
        self._num_envs, self._n_steps = num_envs, n_steps
        self._random = random.Random(seed)
        self.nodes: dict[str, Process] = {}
        self.lives: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self.unexpected: list[str] = []
        self._continue: dict[str, float] = {}

    def begin(self) -> None:
        """Start all of them and wait until the agent learns."""
        for name in NODES:
            self._start(name)
        self.nodes['agent'].wait_for('PPO 1/', START)
        for name in NODES:
            if name.startswith('recorder'):
                self._stop(name, _FIRST_PAUSE)

    def _start(self, name: str) -> None:
        # If the previous process was stopped, its stop ended with it.
        self._continue.pop(name, None)
        if name == 'agent':
            process = self.processes.run_node(
                'ppo_agent_node', 'ppo_agent', run_dir=self.run, resume=bool(self.lives[name]),
                simulators='/sim_*', num_groups=2, n_steps=self._n_steps, iterations=1_000_000,
                # No early stopping, so that all updates take the same time.
                target_kl=0.0, demonstration_episodes=2 * self._num_envs, clone_epochs=4,
                selection_interval=50, selection_episodes=self._num_envs, checkpoint_interval=2)
        elif name.startswith('recorder'):
            simulator = name.replace('recorder', 'sim')
            process = self.processes.run_node(
                'rocket_sim_node', 'rerun_recorder',
                (f'__ns:=/{simulator}', 'training:=/training'),
                # The file reaches max_steps during the warm-up; later growth would be a leak.
                output=self.processes.folder / f'{name}.rrd', max_steps=_RECORDED)
        else:
            process = self.processes.run_node(
                'rocket_sim_node', 'simulator', (f'__ns:=/{name}',), num_envs=self._num_envs)
        self.nodes[name] = process
        self.lives[name] += 1

    def disturb(self, part: float) -> str:
        """Cause a random fault and return its description.

        :param part: elapsed part of the soak
        """
        faults = [fault for fault in FAULTS if part < fault.until]
        fault = self._random.choices(faults, [fault.weight for fault in faults])[0]
        node = self.nodes[fault.node]
        if fault.what == 'stopped':
            self._stop(fault.node, _PAUSE)
        else:
            node.signal(signal.SIGKILL)
            node.wait(10.0)
            self._start(fault.node)
        self.faults[f'{fault.node} {fault.what}'] += 1
        return f'{fault.node} {fault.what}'

    def _stop(self, name: str, seconds: float) -> None:
        self.nodes[name].signal(signal.SIGSTOP)
        self._continue[name] = max(self._continue.get(name, 0.0), time.monotonic() + seconds)

    def until_next(self, mean: float) -> float:
        """Return a random time until the next fault, s."""
        return self._random.uniform(0.5, 1.5) * mean

    def tend(self) -> None:
        """Continue nodes whose stop is over; restart nodes that ended unexpectedly."""
        for name, until in list(self._continue.items()):
            if time.monotonic() > until:
                self.nodes[name].signal(signal.SIGCONT)
                del self._continue[name]
        for name, node in self.nodes.items():
            if not node.running:
                self.unexpected.append(
                    f'{name} ended with {node.wait(1.0)}: {node.output()[-2000:]}')
                self._start(name)

    def incidents(self) -> dict[str, Any]:
        """Return faults, restarts and unexpected exits so far."""
        return {'faults': dict(self.faults), 'lives': dict(self.lives),
                'unexpected': self.unexpected}

    def end(self) -> dict[str, int]:
        """End all; return the exit statuses."""
        for node in self.nodes.values():
            node.signal(signal.SIGCONT)
            node.signal(signal.SIGINT)
        for node in self.nodes.values():
            # A second signal could interrupt a node that is ending normally.
            with suppress(AssertionError):
                node.wait(_END)
        self.processes.end()
        return {name: node.wait(1.0) for name, node in self.nodes.items()}
