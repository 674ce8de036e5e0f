# SPDX-License-Identifier: Apache-2.0
"""Nodes that are forked from a process that has imported PyTorch and NumPy, and so start at once.

For tests of what nodes do once they run: imports are three quarters of the processor time of an
agent's start and half of a simulator's. Tests of starts themselves need real ones.
"""
from __future__ import annotations

import importlib
import multiprocessing
import os
import subprocess
import sys
import time
from contextlib import suppress
from multiprocessing.process import BaseProcess
from pathlib import Path

PRELOADED = (
    'support.training.rank_program', 'ppo_agent_node.commands.report',
    'ppo_agent_node.evaluation.optimum.optimiser', 'ppo_agent_node.pilots.policy',
    'rocket_sim_node.worlds')
"""modules that start no threads when they are imported, as rclpy does; a fork would lack them"""


class ForkedNode:
    """A node with its own session and log; has what `subprocess.Popen` has of a child."""

    def __init__(
        self, package: str, executable: str, arguments: list[str], log: Path, env: dict[str, str],
    ) -> None:
        """Start it."""
        context = multiprocessing.get_context('forkserver')
        context.set_forkserver_preload([*PRELOADED])
        self._process: BaseProcess = context.Process(
            target=_run, args=(package, executable, arguments, log, env), daemon=True)
        self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid
        with suppress(ProcessLookupError):  # it has ended already
            while os.getpgid(self.pid) != self.pid:  # it cannot be signalled yet
                time.sleep(0.001)

    def poll(self) -> int | None:
        """Return the exit status, negative for a signal; None while it runs."""
        return self._process.exitcode

    def wait(self, seconds: float) -> int:
        """Wait for the end and return the exit status.

        :raises subprocess.TimeoutExpired: if it still runs.
        """
        self._process.join(seconds)
        status = self.poll()
        if status is None:
            raise subprocess.TimeoutExpired(str(self._process), seconds)
        return status


def _run(
    package: str, executable: str, arguments: list[str], log: Path, env: dict[str, str],
) -> None:
    """Become a node, as its program does."""
    with open(os.devnull, 'rb') as nothing, log.open('ab') as file:
        for source, number in ((nothing, 0), (file, 1), (file, 2)):
            os.dup2(source.fileno(), number)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(write_through=True)  # type: ignore[union-attr]
    os.environ.clear()
    os.environ.update(env)
    sys.argv = [executable, *arguments]
    program = getattr(importlib.import_module(f'{package}.entry_points'), executable)
    os.setsid()  # from now on it can be signalled
    program()
