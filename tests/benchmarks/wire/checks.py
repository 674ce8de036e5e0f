# SPDX-License-Identifier: Apache-2.0
"""Cost of looking at the sender of each message of a lock-step exchange.

Two simulators run side by side, one of which, like its client, takes every message without looking
at its sender. Exchanges with the two alternate, so that other load affects both.
"""
from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from support.processes import Processes

from benchmarks.wire.agent_node import agent_node
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.node import inbox
from rocket_sim_node.wire.node.far_end import FarEnd
from rocket_sim_node.wire.server.rivals import Rivals

UNCHECKED = '--unchecked'
"""argument of `benchmarks.wire.still_world`"""


class Checks:
    """Switch of the checks in this process."""

    on = True

    @classmethod
    @contextmanager
    def installed(cls) -> Iterator[None]:
        """Let the switch act."""
        sender_of, accepts, look = inbox.sender_of, FarEnd.accepts, Rivals.look
        with (mock.patch.object(
                inbox, 'sender_of', lambda info: sender_of(info) if cls.on else b''),
              mock.patch.object(FarEnd, 'accepts', lambda *args: not cls.on or accepts(*args)),
              mock.patch.object(Rivals, 'look', lambda rivals: cls.on and look(rivals))):
            yield


def measure(num_envs: int, rounds: int, count: int) -> dict[str, NDArray[np.float64]]:
    """Return the times of exchanges with and without the checks, us: `(rounds, count)` each."""
    found = {name: np.empty((rounds + 1, count)) for name in ('checked', 'unchecked')}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        processes = Processes(Path(folder))
        stack.callback(processes.end)
        stack.enter_context(Checks.installed())
        clients = {}
        for name in found:
            simulator = processes.start(
                'python', '-m', 'benchmarks.wire.still_world', str(num_envs),
                *([UNCHECKED] if name == 'unchecked' else []),
                '--ros-args', '-r', f'__ns:=/{name}')
            simulator.wait_for('waiting for an agent', 60.0)
            node, executor = stack.enter_context(
                agent_node('bench_checks', processes.domain, f'/{name}'))
            clients[name] = stack.enter_context(Client(node, executor))
            clients[name].reset(0)
        action = np.zeros((num_envs, 3), np.float32)
        for number, k in itertools.product(range(rounds + 1), range(count)):
            for name in sorted(found, reverse=k % 2 == 1):
                Checks.on = name == 'checked'
                start = time.perf_counter()
                clients[name].step(action)
                found[name][number, k] = 1e6 * (time.perf_counter() - start)
    return {name: times[1:] for name, times in found.items()}


def report(num_envs: int, rounds: int, count: int) -> dict[str, float]:
    """Measure and print; return the ratio with its 95 % interval."""
    medians = {name: np.median(times, 1)
               for name, times in measure(num_envs, rounds, count).items()}
    ratios = medians['checked'] / medians['unchecked']
    interval = stats.bootstrap(
        (ratios,), np.median, confidence_level=0.95, method='percentile',
        rng=np.random.default_rng(0)).confidence_interval
    row = {name: float(np.median(values)) for name, values in medians.items()}
    row |= {'ratio': float(np.median(ratios)), 'low': float(interval.low),
            'high': float(interval.high)}
    print(f'batch {num_envs}: {row["checked"]:.0f} us with the checks of senders, '
          f'{row["unchecked"]:.0f} us without; ratio of the medians of {count}, median of '
          f'{rounds} rounds: {row["ratio"]:.3f} ({row["low"]:.3f} '
          f'to {row["high"]:.3f})', flush=True)
    return row
