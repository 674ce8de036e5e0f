# SPDX-License-Identifier: Apache-2.0
"""A simulator in the process of a test: falling rockets, whose messages the test controls."""
from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.stamps import SimulatedTime
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds import make
from support.processes import wait_until

ROCKETS = 2
FALL = 317
"""samples of a fall from the spawn height to the ground"""


class Simulator:
    """Publishes the states of falling rockets, as a simulator does."""

    def __init__(self, domain: int, rockets: int = ROCKETS) -> None:
        """Create the node in a domain; `ROS_AUTOMATIC_DISCOVERY_RANGE` applies."""
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self._rockets = rockets
        self._node = node = Node('simulator', context=self.context)
        self._world = make('rocket', rockets, level=1, spawn_angle=1.0)
        self.description = node.create_publisher(msg.World, 'world', qos.WORLD)
        self.state = node.create_publisher(msg.RocketState, 'state', qos.EVENTS)
        self.training = node.create_publisher(msg.TrainingStatus, 'training', qos.EVENTS)
        self._session = self._step = 0
        self._time = SimulatedTime(self._world.spec.dt)

    def end(self) -> None:
        """Destroy the node."""
        if self.context.ok():
            self._node.destroy_node()  # otherwise its latched messages would outlive the context
            rclpy.shutdown(context=self.context)

    def take(self, world: str, **settings: Any) -> None:
        """Continue with another world."""
        self._world = make(world, self._rockets, **settings)
        self._time = SimulatedTime(self._world.spec.dt)

    def describe(self) -> None:
        """Publish the description of the world, from which subscribers learn its topics."""
        self.description.publish(
            conversion.world_to_message(self._world.spec, 1, 0, msg.World.LOCKSTEP))

    def begin(self, training: bool = True) -> None:
        """Start a session when `state` has a subscriber.

        :param training: whether to wait for a subscriber of `training` as well.
        """
        wait_until(
            lambda: self.state.get_subscription_count() > 0
            and (not training or self.training.get_subscription_count() > 0), 20.0)
        self._session += 1
        self._time.begin_session(self._step)
        self.description.publish(
            conversion.world_to_message(self._world.spec, self._session, 0, msg.World.LOCKSTEP))
        self._world.reset(self._session)
        self._step = 0
        self._parts: list[tuple[int, np.ndarray]] = []
        self._add()

    def _add(self) -> None:
        for captured in (self._world.captured_ends, self._world.capture(slice(self._rockets))):
            self._parts.append((self._step, captured))

    def telemetry(self) -> Telemetry:
        """Return the state of all rockets."""
        return self._world.telemetry(np.arange(self._rockets))

    def skip(self, steps: int) -> None:
        """Fly some steps without publishing their states."""
        state, self.state = self.state, SimpleNamespace(publish=lambda message: None)
        self.fall(steps)
        self.state = state

    def fall(self, steps: int, action: Any = None) -> None:
        """Fly some steps and publish the states, in messages of 25 steps.

        :param action: action of all rockets at each step: a row of numbers, or one number if
            actions are discrete; None: idle.
        """
        spec = self._world.spec
        given = spec.action_idle if action is None else np.atleast_1d(action)
        every = (
            np.tile(np.float32(given), (self._rockets, 1)) if spec.continuous
            else np.full(self._rockets, given[0], np.int32))
        for _ in range(steps):
            self._world.step(every)
            self._step += 1
            self._add()
        for start in range(0, len(self._parts), 25):
            parts = self._parts[start:start + 25]
            step = np.concatenate([np.full(c.shape[1], s, np.uint64) for s, c in parts])
            telemetry = self._world.telemetry_of(np.concatenate([c for _, c in parts], axis=1))
            self.state.publish(
                conversion.state_to_message(
                    step, telemetry, self._session, self._time.at(parts[-1][0])))
        self._parts = []
