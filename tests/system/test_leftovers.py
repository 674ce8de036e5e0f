# SPDX-License-Identifier: Apache-2.0
"""What killed nodes leave in shared memory is gone once another has started, and no more."""
from __future__ import annotations

import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shared_memory
from processes import Processes
from training_runs import simulator

from rocket_sim_node.wire.leftovers import SHARED_MEMORY
from rocket_sim_node.worlds import make

ROUNDS, NIGHTLY_ROUNDS = 4, 50
OLD = 2.5
"""s after which what is left is taken for that of a dead process, and not of one that starts"""


@pytest.mark.timeout(600)
def test_leftovers_of_killed_nodes_are_removed_at_the_next_start(
        processes: Processes, make_client: Callable[..., Any], nightly: bool) -> None:
    living = simulator(processes)
    client, world = make_client(), make('rocket', num_envs=8)
    client.reset(1)
    world.reset(1)
    dead: set[str] = set()
    for number in range(NIGHTLY_ROUNDS if nightly else ROUNDS):
        node = simulator(processes, namespace=f'/sim_{number}')
        node.wait_for('waiting for an agent', 30.0)
        dead |= shared_memory.owned(node)
        node.signal(signal.SIGKILL)
        node.wait(5.0)
    before = shared_memory.left(dead)
    assert before, dead
    used = shared_memory.files(shared_memory.owned(living))
    assert used
    time.sleep(OLD)
    last = simulator(processes, namespace='/last')
    last.wait_for('waiting for an agent', 30.0)
    after = shared_memory.left(dead)
    print(f'{len(dead)} segments and ports of killed nodes: {len(before)} files of them before '
          f'another node started, {len(after)} after; {len(used)} of a living one stay')
    assert not after
    assert used == shared_memory.files(shared_memory.owned(living))
    assert SHARED_MEMORY == shared_memory.FOLDER
    # The living exchange as before, in the same session.
    action = np.zeros((8, 3), np.float32)
    for _ in range(100):
        np.testing.assert_array_equal(client.step(action)[0], world.step(action)[0])
