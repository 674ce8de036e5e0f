# SPDX-License-Identifier: Apache-2.0
"""Connection of this package's nodes to simulators."""
from __future__ import annotations

import hashlib
import os
import socket
from dataclasses import dataclass
from pathlib import Path

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.config.connection_config import ConnectionConfig
from ppo_agent_node.distributed.errors import RankLost
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.client.fleet import SimulatorFleet
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import EnvironmentRestarted

EXPECTED_ERRORS = (
    ParameterError, WireTimeout, SimulatorBusy, EnvironmentRestarted, RankLost, ValueError,
    OSError)
"""Errors with external causes: reported in one line, without a traceback."""


@dataclass(frozen=True)
class ConnectionParameters(ConnectionConfig):
    """Time limits of the connection to the simulator."""

    def link_options(self) -> ConnectionOptions:
        """Return them as options of a connection."""
        return ConnectionOptions(self.resend_after, self.patience, self.acknowledge)


def make_client(
    node: Node, executor: Executor, parameters: ConnectionParameters, agent: int | None = None,
) -> Client:
    """Return a client of the simulator in the node's namespace."""
    return Client(node, executor, parameters.link_options(), agent)


def make_fleet(
    node: Node, executor: Executor, parameters: ConnectionParameters, simulators: str, agent: int,
    second: str = '',
) -> SimulatorFleet:
    """Return all simulators that train one agent."""
    return SimulatorFleet(node, executor, parameters.link_options(), agent, simulators, second)


def require_lockstep(client: Client | SimulatorFleet) -> None:
    """Check that the simulator runs in lock-step, so that no step can be missed.

    :raises ValueError: when it runs in real time.
    """
    if client.realtime:
        raise ValueError('simulator: mode is realtime, expected lockstep')


def agent_of_run(run: Path) -> int:
    """Return a run's identity, the same when it is resumed, so that it may continue at once."""
    return agent_named(str(run.resolve()))


def agent_named(name: str) -> int:
    """Return the identity for a name on this machine.

    Containers may share the host's name; their root directory distinguishes them.
    """
    root = os.stat('/')
    name = f'{socket.gethostname()}:{root.st_dev}:{root.st_ino}:{name}'
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], 'little') or 1
