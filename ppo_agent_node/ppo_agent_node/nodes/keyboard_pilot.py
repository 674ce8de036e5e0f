# SPDX-License-Identifier: Apache-2.0
"""Node `keyboard_pilot`: a person flies, from the terminal in which the node was started."""
from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from dataclasses import replace

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.cockpit.display import Cockpit
from ppo_agent_node.cockpit.raw_terminal import RawTerminal
from ppo_agent_node.nodes.flights.connection import EXPECTED_ERRORS
from ppo_agent_node.nodes.flights.connection import ConnectionParameters
from ppo_agent_node.nodes.flights.connection import agent_named
from ppo_agent_node.nodes.flights.hand_flying import EpisodeStart
from ppo_agent_node.nodes.flights.hand_flying import HandFlying
from ppo_agent_node.pilots.keyboard import KeyboardPilot
from ppo_agent_node.pilots.keyboard import KeyboardSettings
from ppo_agent_node.pilots.keyboard import StartSettings
from ppo_agent_node.pilots.keys import EXACT_OFF
from ppo_agent_node.pilots.keys import EXACT_ON
from rocket_sim_node import ros_environment
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import WorldSpec

_PATIENCE = 3.0
"""Seconds to wait for an answer before checking the keys again."""
_NOTICE = 3.0
"""Seconds without a simulator before a message is shown."""


@dataclass(frozen=True)
class KeyboardParameters(StartSettings):
    """Parameters of the node, beside those of the keys and the connection."""

    watch: str = setting('', '', 'address at which the flights can be watched, shown on the '
        'screen')


def _agent(node: Node) -> int:
    """Return the identity for this terminal, so that a restarted node may continue at once."""
    return agent_named(f'{os.ttyname(sys.stdin.fileno())}:{node.get_namespace()}')


def _connect(node: Node, client: Client, patience: float) -> WorldSpec:
    """Wait for a simulator.

    :raises WireTimeout: when there is none for `patience` s.
    """
    begin = time.monotonic()
    noticed = False
    while True:
        try:
            return client.connect()
        except WireTimeout:
            waited = time.monotonic() - begin
            topic = node.resolve_topic_name('world')
            if waited >= patience:
                raise WireTimeout(
                    f'waited {waited:.0f} s for the simulator of {topic}; '
                    f'{ros_environment.advice(os.environ)}') from None
            if waited > _NOTICE and not noticed:
                noticed = True
                node.get_logger().warning(
                    f'no simulator of {topic} yet; start one: ros2 run rocket_sim_node simulator '
                    '--ros-args -p num_envs:=1 -p mode:=realtime')


def pilot(node: Node, executor: Executor) -> None:
    """Fly until the person or a signal stops it."""
    parameters = Parameters(node)
    options = parameters.declare(KeyboardParameters)
    keys = parameters.declare(KeyboardSettings)
    connection = parameters.declare(ConnectionParameters)
    parameters.finish()
    terminal = RawTerminal(EXACT_ON, EXACT_OFF)
    client = Client(
        node, executor,
        replace(connection.link_options(), patience=min(_PATIENCE, connection.patience)),
        _agent(node))
    with client:
        spec = _connect(node, client, connection.patience)
        start = EpisodeStart(options.seed, options.level if 'level' in spec.settings else 0)
        flying = HandFlying(
            node, client, terminal, Cockpit(), KeyboardPilot(spec, keys), start, options.watch)
        with terminal:
            flying.run()
    node.get_logger().info(flying.summary() or 'no flights')


def main() -> None:
    """Run the node."""
    leave(run('keyboard_pilot', pilot, EXPECTED_ERRORS))


if __name__ == '__main__':
    main()
