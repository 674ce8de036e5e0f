# SPDX-License-Identifier: Apache-2.0
"""Node `ros_bridge`: rockets as standard messages of ROS, for RViz, Foxglove, tf2 and others.

It reads topics `world` and `state` only; no other node depends on it.
"""
from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node.nodes.bridge.publishers import BridgePublishers
from rocket_sim_node.nodes.bridge.topics import Topics
from rocket_sim_node.nodes.listeners import NICENESS
from rocket_sim_node.nodes.listeners import SPIN_PERIOD
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.settings import setting
from rocket_sim_node.standard_views.motion import MotionViews
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.invalid_input import ignore_invalid_input
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.wire.node.steady_clock import STEADY

if TYPE_CHECKING:  # it needs foxglove-sdk
    from rocket_sim_node.nodes.bridge.foxglove_server import FoxgloveServer


@dataclass(frozen=True)
class BridgeParameters:
    """Parameters of the node."""

    rows: tuple[int, ...] = setting(
        (0, 1, 2, 3), '', 'numbers of the rockets to show, of those that the simulator publishes',
        0, 1e9)
    max_rate: float = setting(
        60.0, 'Hz', 'maximum number of steps published per second of wall clock; 0: every step. '
        'Starts and ends of episodes are always published', 0.0, 1e6)
    clock: bool = setting(
        False, '', 'whether to publish /clock, for nodes with use_sim_time')
    frame_prefix: str = setting(
        '', '', 'prefix of the frame names rocket_<i>/..., e.g. sim_0/; needed with more than '
        'one simulator')
    serve_foxglove: bool = setting(
        False, '', 'whether to serve the same messages to Foxglove, live')
    foxglove_port: int = setting(8765, '', 'port to which Foxglove connects', 1, 65535)
    foxglove_host: str = setting(
        '127.0.0.1', '', 'address at which that is served. The default is this machine only; '
        'with 0.0.0.0 anyone who can reach this machine can see the flights')


class BridgeNode:
    """Passes messages of a simulator to the publishers of standard messages."""

    def __init__(
        self, node: Node, parameters: BridgeParameters, foxglove: FoxgloveServer | None = None,
    ) -> None:
        """Create publishers, then subscriptions; a server sends the same messages to Foxglove."""
        self._node = node
        self._views = MotionViews(parameters.rows, parameters.max_rate)
        self._stamp = 0
        self._publishers = BridgePublishers(
            Topics(node, foxglove), parameters.rows, parameters.frame_prefix, parameters.clock)
        for kind, topic, callback, profile in (
            (msg.World, 'world', self._on_world, qos.READ_WORLD),
            (msg.RocketState, 'state', self._on_state, qos.EVENTS),
        ):
            node.create_subscription(kind, topic, callback, profile)

    def _on_world(self, message: msg.World) -> None:
        with ignore_invalid_input(self._node, 'world'):
            spec = conversion.world_from_message(message)
            info = WorldInfo.build(
                spec.name, spec.dt, spec.outcomes,
                conversion.settings_from_message(message.settings), spec.condition_names)
            if info != self._views.world:
                self._publishers.begin(info, spec.num_envs, self._stamp)
                self._views.world = info

    def _on_state(self, message: msg.RocketState) -> None:
        with ignore_invalid_input(self._node, 'state'):
            missed = self._views.missed
            for moment in self._views.add(
                    message.session, samples_of(message),
                    conversion.stamp_of(message.header)):
                self._stamp = moment.stamp
                self._publishers.publish(moment)
            if self._views.missed > missed:
                self._node.get_logger().warning(
                    f'state: {self._views.missed - missed} steps were not received',
                    throttle_duration_sec=1.0, throttle_time_source_type=STEADY)

    def summary(self) -> str:
        """Return how many steps were shown, left out and missed."""
        views = self._views
        left_out = f'; {views.skipped} skipped because of max_rate' if views.skipped else ''
        lost = f'; {views.missed} steps were not received' if views.missed else ''
        return f'{views.shown} states shown{left_out}{lost}'


def bridge(node: Node, executor: Executor) -> None:
    """Publish until asked to stop."""
    os.nice(NICENESS)
    parameters = Parameters(node)
    options = parameters.declare(BridgeParameters)
    parameters.finish()
    with ExitStack() as stack:
        server = None
        if options.serve_foxglove:
            # Imported only now, as foxglove-sdk is optional.
            from rocket_sim_node.nodes.bridge.foxglove_server import FoxgloveServer
            server = FoxgloveServer(options.foxglove_port, options.foxglove_host)
            stack.callback(server.close)
            node.get_logger().info(f'Foxglove can connect to {server.url}')
        viewed = BridgeNode(node, options, server)
        rows = ', '.join(map(str, options.rows)) or 'none'
        node.get_logger().info(f'publishing standard views of rockets {rows}')
        while not stopping.requested():
            executor.spin_once(timeout_sec=SPIN_PERIOD)
            if server is not None:
                server.serve_latecomers()
    node.get_logger().info(viewed.summary())


def main() -> None:
    """Run the node."""
    leave(run('ros_bridge', bridge, expected=(ParameterError, ValueError)))


if __name__ == '__main__':
    main()
