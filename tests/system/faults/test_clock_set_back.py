# SPDX-License-Identifier: Apache-2.0
"""Flights continue when the system clock is set back; see `wire.node.clock_steps`."""
from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rocket_msgs import msg
from support.machine.stepped_clock import SteppedClock
from support.processes import Processes
from support.processes import ros_args
from support.processes import wait_until

from rocket_sim_node.wire.dds import qos

DAY = 86_400.0
STEPS, NIGHTLY_STEPS = 4, 40
PERIOD = 0.1
"""s of the steady clock between two observations, at a fifth of real time"""


@pytest.mark.timeout(300)
def test_a_real_time_flight_continues(
        processes: Processes, make_node: Callable[..., Any], tmp_path: Path,
        nightly: bool) -> None:
    clock = SteppedClock(tmp_path)
    processes.start(*clock.command(
        'ros2', 'run', 'rocket_sim_node', 'simulator',
        *ros_args(num_envs=2, mode='realtime', realtime_factor=0.2)))
    processes.start(*clock.command(
        'ros2', 'run', 'ppo_agent_node', 'random_pilot', *ros_args(episodes=0)))
    node, executor = make_node()
    received = 0

    def count(message: bytes) -> None:
        nonlocal received
        received += 1

    node.create_subscription(
        msg.Observation, 'observation', count, qos.read_stream('always'), raw=True)

    def flown(steps: int) -> Callable[[], bool]:
        until = received + steps

        def done() -> bool:
            executor.spin_once(timeout_sec=0.01)
            return received >= until
        return done

    wait_until(flown(5), 60.0, processes.logs)
    for number in range(NIGHTLY_STEPS if nightly else STEPS):
        time.sleep(number % 5 / 5 * PERIOD)  # at another moment of a wait each time
        clock.set(-DAY * (number + 1))
        wait_until(flown(10), 10.0, processes.logs)
