# SPDX-License-Identifier: Apache-2.0
"""Shared memory of nodes, and what is left of it when they are killed."""
from __future__ import annotations

import re
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support import exchange_probe
from support import shared_memory
from support import start_beside
from support.processes import Process
from support.processes import Processes
from support.training_runs import make_world
from support.training_runs import simulator

from rocket_sim_node.wire.dds.shared_memory_cleanup import SHARED_MEMORY

TOGETHER = 4
"""simulators killed at once, and the agent of one"""
BATCHES, NIGHTLY_BATCHES = 1, 13
KEPT = re.compile(r'sem\.fast(dds|rtps)_port70\d\d_mutex')
"""the guard of a port that other programs use as well"""
OLD = 2.5
"""s after which what is left is taken for that of a dead process, and not of one that starts"""


def queues(process: Process) -> list[str]:
    """Return the queues in shared memory from which a process reads."""
    return [name for name in shared_memory.owned(process) if 'port' in name]


def test_an_agent_has_a_queue_in_shared_memory_and_a_simulator_has_none(
        processes: Processes) -> None:
    """A writer to a killed process waits for the lock of its queue, see `wire.dds.transport`."""
    world = simulator(processes)
    agent = processes.start(sys.executable, exchange_probe.__file__)
    agent.wait_for('exchange', 60.0)
    assert queues(agent)
    assert not queues(world)
    assert shared_memory.owned(world), 'it sends by it'


@pytest.mark.timeout(600)
def test_leftovers_of_killed_nodes_are_removed_at_the_next_start(
        processes: Processes, make_client: Callable[..., Any], nightly: bool) -> None:
    living = simulator(processes)
    client, world = make_client(), make_world()
    client.reset(1)
    world.reset(1)
    used = shared_memory.files(shared_memory.owned(living))
    assert used
    for _ in range(NIGHTLY_BATCHES if nightly else BATCHES):
        nodes = [simulator(processes, namespace=f'/sim_{number}') for number in range(TOGETHER)]
        for node in nodes:
            node.wait_for('waiting for an agent', 60.0)
        nodes.append(processes.start(
            sys.executable, exchange_probe.__file__, '--ros-args', '-r', '__ns:=/sim_0'))
        nodes[-1].wait_for('exchange', 60.0)
        assert queues(nodes[-1])
        dead = set().union(*map(shared_memory.owned, nodes))
        for node in nodes:
            node.signal(signal.SIGKILL)
        for node in nodes:
            node.wait(5.0)
        before = shared_memory.files(dead)
        assert len(before) > TOGETHER
        # A living peer that still writes to a dead one may create its port anew just before the
        # next start, which then leaves it, as it is young; the one after it removes it.
        for _ in range(2):
            time.sleep(OLD)
            following = simulator(processes, namespace='/following')
            following.wait_for('waiting for an agent', 60.0)
            after = shared_memory.left(dead)
            following.signal(signal.SIGINT)
            assert following.wait(10.0) == 0
            if all(KEPT.fullmatch(file) for file in after):
                break
        print(f'{len(nodes)} nodes killed: {len(before)} files, {len(after)} once another started')
        assert len(after) <= 1
        assert all(KEPT.fullmatch(file) for file in after), after
    # One that lives keeps its files, and exchanges as before, in the same session.
    assert used <= shared_memory.files(shared_memory.owned(living))
    assert SHARED_MEMORY == shared_memory.FOLDER
    action = np.zeros((8, 3), np.float32)
    for _ in range(100):
        np.testing.assert_array_equal(client.step(action)[0], world.step(action)[0])


def test_who_starts_while_leftovers_are_removed_keeps_its_port(
        processes: Processes, nightly: bool) -> None:
    # In a /dev/shm of their own, among processes of their own: all participants of a machine try
    # the same ports, and what one of them has mapped is not removed.
    alone = (
        'unshare', '--mount', '--pid', '--fork', '--kill-child', '--mount-proc',
        'sh', '-c', 'mount -t tmpfs beside /dev/shm && exec "$@"', 'sh')
    if processes.start(*alone, 'true').wait(10.0):
        pytest.skip('mounts and process ids of its own need root')
    rounds = 500 if nightly else 10
    beside = processes.start(*alone, sys.executable, start_beside.__file__, str(rounds))
    status = beside.wait(1200.0 if nightly else 120.0)
    lines = beside.output().splitlines()
    lost = sum(line.startswith('lost') for line in lines)
    print(f'{rounds} participants started while leftovers were removed: {lost} lost a port')
    assert (status, lost) == (0, 0), beside.output()
    assert f'done {rounds}' in lines
