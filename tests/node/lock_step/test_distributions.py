# SPDX-License-Identifier: Apache-2.0
"""Differences between distributions of ROS 2: the same results on each."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rocket_msgs import msg
from support.processes import Processes
from support.processes import ros_args

from rocket_sim_node import worlds
from rocket_sim_node.wire import distributions
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.polling import ArraySubscription

pytestmark = pytest.mark.smoke

SIMULATOR = """
import sys
from rocket_sim_node.wire import distributions
distributions._rclpy = None
from rocket_sim_node.nodes.simulator import main
sys.exit(main())
"""


def test_a_context_lasts_as_long_as_its_block(processes: Processes) -> None:
    context = Context()
    with distributions.initialised(context=context, domain_id=processes.domain):
        assert rclpy.ok(context=context)
    assert not rclpy.ok(context=context)


def test_this_rclpy_supports_the_fast_path(make_node: Callable[..., Any]) -> None:
    """A failure means that rclpy has changed: see `distributions.subscribe`."""
    node, _ = make_node()
    subscription = ArraySubscription(
        node, msg.Observation, 'observation', qos.read_stream('always'))
    assert subscription.handle is not None


def test_an_exchange_by_the_public_api_has_the_same_bits(
        processes: Processes, make_client: Callable[..., Client],
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distributions, '_rclpy', None)
    processes.start('python', '-c', SIMULATOR, *ros_args(num_envs=4)).wait_for(
        'waiting for an agent', 60.0)
    with make_client() as client:
        assert all(subscription.handle is None for subscription in ArraySubscription._open)
        world = worlds.make('rocket', num_envs=4)
        assert np.array_equal(client.reset(3), world.reset(seed=3))
        random = np.random.default_rng(0)
        for _ in range(20):
            action = random.uniform(-1.0, 1.0, (4, 3)).astype(np.float32)
            ours, theirs = world.step(action), client.step(action)
            assert np.array_equal(ours[0], theirs[0])
            assert np.array_equal(ours[1], theirs[1])
